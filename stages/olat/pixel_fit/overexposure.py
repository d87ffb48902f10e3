"""Overexposed samples brought down as the paper does it (PRF Algorithm 1), kept as a named option."""

from __future__ import annotations

import numpy as np

from pipeline.kernels.compiling import kernel
from pipeline.kernels.numerics import ZERO


@kernel(error_model="numpy")
def remove_overexposure(samples, level, order, delta, gap, rounds):
    """PRF Algorithm 1 on one channel's samples [N], only where one reaches `level`: spikes come down to the next value + delta.

    Every rank before the first gap wider than `gap` (PRF's epsilon) of the maximum comes down, `rounds` times (M): first of the
    samples that reach the level, then whatever still stands out. The printed form mixes ranks and indices. Returns the sum of
    the positive samples before, and what of it was removed.
    """
    top, before, removed = ZERO, 0.0, 0.0
    for k in range(samples.size):
        top = max(top, samples[k])
        before += max(samples[k], ZERO)
    if not top >= level:
        return before, 0.0
    for turn in range(rounds):
        for k in range(samples.size):
            order[k] = 0  # 1: a rank that is done
        first = highest = -1.0
        for rank in range(samples.size):
            best = -1
            for k in range(samples.size):
                if order[k] == 0 and (best < 0 or samples[k] > samples[best]):
                    best = k
            if rank == 0:
                first = samples[best]
            elif highest - samples[best] > gap * first:
                low = samples[best] + delta
                for k in range(samples.size):
                    if order[k] == 1:
                        removed += samples[k] - low
                        samples[k] = low
                break
            if turn == 0 and samples[best] < level:
                break
            highest = samples[best]
            order[best] = 1
    return before, removed


@kernel(error_model="numpy")
def remove_all(cross, parallel, settings, order, out):
    """Algorithm 1 on the channels of both passes [3, N], in place; `out` [2]: the share of each pass's light that goes."""
    for which in range(2):
        samples = cross if which == 0 else parallel
        whole = gone = 0.0
        for c in range(3):
            delta = cross.dtype.type(max(np.mean(parallel[c]), 0.0))
            before, removed = remove_overexposure(samples[c], settings.saturation, order, delta, settings.gap,
                                                  settings.removals)  # fmt: skip
            whole += before
            gone += removed
        out[which] = gone / whole if whole > 0 else 0.0
