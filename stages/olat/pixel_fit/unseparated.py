"""One pass for both: frames behind no polariser, or a parallel one alone, hold diffuse and specular light together.

The diffuse part is what most lights agree on: highlights lie above it, shadows below. Highlights are bright, so a fit that
starts at the brightest samples starts on them; here it starts on several windows of the samples by rank, and the start whose
prediction the most samples bear out is refined. What a sample exceeds its prediction by is specular light.
"""

from __future__ import annotations

import math

from pipeline.kernels.compiling import kernel
from pipeline.kernels.numerics import FAST, ONE, ZERO, kth_largest, solve3
from stages.olat.pixel_fit.diffuse import fit_normal, refined
from stages.olat.pixel_fit.fit_options import PARALLEL_ALONE

WINDOWS = ((0.05, 0.4), (0.15, 0.5), (0.3, 0.65))  # of the samples by rank, brightest first: between highlights and shadows
CLOSE = 0.08  # of the upper quartile: a sample this near to its prediction bears it out


@kernel(fastmath=FAST, error_model="numpy")
def _unexplained(light, ok, wx, wy, wz, x, y, z, inverse):
    """Sum of the samples' misses (the prediction behind the surface is 0), each bounded by 1."""
    s = ZERO * light[0]
    for k in range(light.size):
        p = x * wx[k] + y * wy[k] + z * wz[k]
        p = p if p > ZERO else ZERO
        t = (light[k] - p) * inverse
        s += ok[k] * min(t * t, ONE)
    return float(s)


@kernel(fastmath=FAST, error_model="numpy")
def _between(light, ok, wx, wy, wz, low, high):
    """Normal equations of the samples between two levels."""
    a = b = c = d = e = f = x = y = z = n = ZERO * light[0]
    for k in range(light.size):
        v = light[k]
        w = ok[k] if (v > low) & (v < high) else ZERO
        p, q, r = w * wx[k], w * wy[k], w * wz[k]
        a += p * wx[k]
        b += p * wy[k]
        c += p * wz[k]
        d += q * wy[k]
        e += q * wz[k]
        f += r * wz[k]
        x += p * v
        y += q * v
        z += r * v
        n += w
    return a, b, c, d, e, f, x, y, z, n


@kernel(error_model="numpy")
def fit_mixed_normal(light, ok, wx, wy, wz, rounds, plain, weight, work):
    """Scaled diffuse normal of one pixel whose samples hold highlights too; arguments and result as `diffuse.fit_normal`."""
    kind = light.dtype.type
    best = fit_normal(light, ok, wx, wy, wz, rounds, plain, weight, work)
    usable = 0
    for k in range(light.size):
        work[k] = light[k] if ok[k] > ZERO else -ONE
        usable += 1 if ok[k] > ZERO else 0
    if usable < 6:
        return best
    quartile = kth_largest(work, usable // 4)
    if not quartile > 0:
        return best
    inverse = kind(1.0 / (CLOSE * quartile))
    least = 2.0 * usable
    if best[5]:
        least = _unexplained(light, ok, wx, wy, wz, kind(best[0]), kind(best[1]), kind(best[2]), inverse)
    for first, last in WINDOWS:
        for k in range(light.size):
            work[k] = light[k] if ok[k] > ZERO else -ONE
        high, low = kth_largest(work, int(first * usable)), kth_largest(work, min(int(last * usable), usable - 1))
        a, b, c, d, e, f, x, y, z, n = _between(light, ok, wx, wy, wz, low, high)
        if n < 4:
            continue
        mx, my, mz, solved = solve3(a, b, c, d, e, f, x, y, z)
        if not solved:
            continue
        found = refined(light, ok, wx, wy, wz, mx, my, mz, usable, rounds, plain, weight, work)
        miss = _unexplained(light, ok, wx, wy, wz, kind(found[0]), kind(found[1]), kind(found[2]), inverse)
        if miss < least:
            best, least = found, miss
    if best[5]:  # the weights of the one that is kept
        size = math.sqrt(best[0] ** 2 + best[1] ** 2 + best[2] ** 2)
        return refined(light, ok, wx, wy, wz, best[0], best[1], best[2], usable, 4, plain, weight, work) if size > 0 else best
    return best


@kernel(error_model="numpy")
def diffuse_normal(workspace, w, settings):
    """Scaled diffuse normal of one pixel: by `fit_normal`, or `fit_mixed_normal` where the samples hold highlights too."""
    rounds, plain, weight, work = settings.rounds, settings.plain, workspace.weight, workspace.work
    if settings.one_pass < PARALLEL_ALONE:
        return fit_normal(workspace.diffuse, workspace.ok, w[0], w[1], w[2], rounds, plain, weight, work)
    return fit_mixed_normal(workspace.diffuse, workspace.ok, w[0], w[1], w[2], rounds, plain, weight, work)


@kernel(fastmath=FAST, error_model="numpy")
def leave_specular(diffuse, ok, wx, wy, wz, x, y, z, clear, scale, specular):
    """Fill `specular` [N] with how far the samples of lights before the surface are from the prediction m . l, times `scale`;
    an excess above `clear` is taken from `diffuse`, so that it is not counted twice."""
    for k in range(diffuse.size):
        p = x * wx[k] + y * wy[k] + z * wz[k]
        rest = ok[k] * (diffuse[k] - p)
        rest = rest if p > ZERO else ZERO
        specular[k] = rest * scale
        diffuse[k] = p if rest > clear else diffuse[k]
