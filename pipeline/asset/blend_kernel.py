"""Inner loops of blending views in texels (numba)."""

from __future__ import annotations

import numpy as np
from numba import prange

from pipeline.kernels.compiling import kernel


@kernel(nogil=True)
def keep_best(
    at,  # [N] int64, texels
    weight,  # [N] float32
    number,  # int16, the view
    view,  # [T, K] int16; updated
    best,  # [T, K] float32; updated
):
    """Put a view in the place of the worst one that a texel has, where it is better."""
    for n in range(len(at)):
        t, worst = at[n], 0
        for k in range(1, best.shape[1]):
            if best[t, k] < best[t, worst]:
                worst = k
        if weight[n] > best[t, worst]:
            best[t, worst], view[t, worst] = weight[n], number


@kernel(parallel=True, nogil=True)
def sample(
    image,  # [H, W, C] float32
    weight,  # [H, W] float32
    x,  # [N] float64, pixels, centres at +0.5
    y,  # [N] float64
    values,  # [N, C] float32; written
    shares,  # [N] float32; written
):
    """Bilinear means of the pixels that count, and how much of the four counts."""
    height, width, channels = image.shape
    for n in prange(len(x)):
        left, top = int(np.floor(x[n] - 0.5)), int(np.floor(y[n] - 0.5))
        u, v = x[n] - 0.5 - left, y[n] - 0.5 - top
        total = 0.0
        for c in range(channels):
            values[n, c] = 0.0
        for dy in range(2):
            for dx in range(2):
                row, column = min(max(top + dy, 0), height - 1), min(max(left + dx, 0), width - 1)
                w = (u if dx else 1.0 - u) * (v if dy else 1.0 - v) * weight[row, column]
                if w > 0.0:
                    total += w
                    for c in range(channels):
                        values[n, c] += w * image[row, column, c]
        shares[n] = total
        if total > 0.0:
            for c in range(channels):
                values[n, c] /= total


@kernel(parallel=True, nogil=True)
def robust_mean(
    values,  # [T, K, C] float32
    weight,  # [T, K] float32, 0: no sample
    floor,  # [C] float32, deviations that mean nothing
    out,  # [T, C] float32; written, 0 where no sample counts
    error,  # [T, C] float32; written, the mean's standard error by that deviation
):
    """Tukey's biweight about the weighted median, at three times its weighted median deviation."""
    texels, most, channels = values.shape
    for t in prange(texels):
        order, deviation = np.empty(most, np.int64), np.empty(most, np.float64)
        for c in range(channels):
            median = _weighted_median(values[t, :, c], weight[t], order)
            for k in range(most):
                deviation[k] = abs(values[t, k, c] - median)
            spread = 1.4826 * _weighted_median(deviation, weight[t], order)
            reach = 3.0 * (spread + floor[c])
            total, squares, mean = 0.0, 0.0, 0.0
            for k in range(most):
                if weight[t, k] > 0.0 and deviation[k] < reach:
                    share = 1.0 - (deviation[k] / reach) ** 2
                    share *= share * weight[t, k]
                    total += share
                    squares += share * share
                    mean += share * values[t, k, c]
            out[t, c] = mean / total if total > 0.0 else 0.0
            error[t, c] = spread * np.sqrt(squares) / total if total > 0.0 else 0.0


@kernel(nogil=True)
def _weighted_median(values, weight, order):
    """The value at which half of the weight is reached; 0 where there is none. `order` [K] is room to work in."""
    count, whole = 0, 0.0
    for k in range(len(values)):
        if weight[k] > 0.0:
            whole += weight[k]
            place = count
            while place > 0 and values[order[place - 1]] > values[k]:
                order[place] = order[place - 1]
                place -= 1
            order[place] = k
            count += 1
    reached = 0.0
    for n in range(count):
        reached += weight[order[n]]
        if reached >= 0.5 * whole:
            return np.float64(values[order[n]])
    return 0.0
