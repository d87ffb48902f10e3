"""Diffuse and specular samples from the crossed and the parallel ones."""

from __future__ import annotations

import math

from pipeline.kernels.compiling import kernel
from pipeline.kernels.numerics import FAST, LARGEST, ONE, ZERO
from stages.olat.pixel_fit.fit_options import BOTH, UNPOLARISED


@kernel(fastmath=FAST, error_model="numpy")
def _finite(a, b, c, d, e, f, fine):
    """`fine` [N]: 1 where all six samples are finite, else 0; returns how many are not."""
    bad = ZERO
    for k in range(fine.size):
        whole = abs(a[k] + b[k] + c[k] + d[k] + e[k] + f[k]) < LARGEST  # false for NaN and Inf
        fine[k] = ONE if whole else ZERO
        bad += ZERO if whole else ONE
    return bad


@kernel(fastmath=FAST, error_model="numpy")
def _clipped(a, b, c, level, out):
    """`out` [N]: 1 where a channel reaches `level`, else 0."""
    for k in range(out.size):
        out[k] = ONE if max(a[k], b[k], c[k]) >= level else ZERO


@kernel(fastmath=FAST, error_model="numpy")
def _scaled(sample, fine, energy, gain, scale, out):
    for k in range(out.size):
        v, e = sample[k] * gain[k], energy[k]
        out[k] = scale * v / e if fine[k] > ZERO else ZERO


@kernel(fastmath=FAST, error_model="numpy")
def _mean(a, b, c, third, out):
    top = ZERO * a[0]
    for k in range(out.size):
        v = (a[k] + b[k] + c[k]) * third
        out[k] = v
        top = max(top, v)
    return top


@kernel(fastmath=FAST, error_model="numpy")
def _difference(a, b, c, ga, gb, gc, crossed, fine, energy, scale, per_cross, out):
    """Parallel less crossed samples; `crossed` is their mean in albedo units."""
    top = ZERO * energy[0]
    for k in range(out.size):
        v = scale * (a[k] * ga[k] + b[k] * gb[k] + c[k] * gc[k]) / energy[k] - per_cross * crossed[k]
        v = v if fine[k] > ZERO else ZERO
        out[k] = v
        top = max(top, v)
    return top


@kernel(fastmath=FAST, error_model="numpy")
def _marks(fine, floor, ok):
    """`ok` [N], where a crossed sample is clipped, becomes where it can be used; returns how many lights are clipped."""
    clipped = ZERO * fine[0]
    for k in range(ok.size):
        x, p, f = ok[k], floor[k], fine[k]
        clipped += max(x, p)
        ok[k] = f * (ONE - x)
    return clipped


@kernel(error_model="numpy")
def separate(cross, parallel, energy, gains, settings, level, workspace):
    """I_d = 2 I_x and I_s = f (I_p - I_x) per unit of irradiance; marks samples that are not finite or clipped.

    cross, parallel [3, N]; gains [3, N]: what makes each light white. Returns (samples that are bad, clipped, brightest
    diffuse, brightest specular). Many short loops, each over few arrays: one long loop would not vectorise.
    """
    kind = energy.dtype.type
    halved = 1.0 if settings.one_pass == UNPOLARISED else 2.0
    scale_d = kind(halved * math.pi / settings.irradiance)
    scale_s = kind(settings.specular_factor / (3.0 * settings.irradiance))
    per_cross = kind(settings.specular_factor / (2.0 * math.pi))
    fine = workspace.scratch
    bad = _finite(cross[0], cross[1], cross[2], parallel[0], parallel[1], parallel[2], fine)
    _clipped(cross[0], cross[1], cross[2], level, workspace.ok)
    _clipped(parallel[0], parallel[1], parallel[2], level, workspace.floor)
    for c in range(3):
        _scaled(cross[c], fine, energy, gains[c], scale_d, workspace.rgb[c])
    top_d = _mean(workspace.rgb[0], workspace.rgb[1], workspace.rgb[2], kind(1.0 / 3.0), workspace.diffuse)
    if settings.one_pass != BOTH:  # the passes are one: what there is of specular light is found after the diffuse fit
        for k in range(workspace.specular.size):
            workspace.specular[k] = kind(0.0)
        clipped = _marks(fine, workspace.floor, workspace.ok)
        return int(bad), int(clipped), top_d, kind(0.0)
    top_s = _difference(
        parallel[0], parallel[1], parallel[2], gains[0], gains[1], gains[2], workspace.diffuse, fine, energy, scale_s,
        per_cross, workspace.specular,
    )  # fmt: skip
    clipped = _marks(fine, workspace.floor, workspace.ok)
    return int(bad), int(clipped), top_d, top_s
