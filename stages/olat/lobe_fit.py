"""Which lobe explains a pixel's specular samples: round or anisotropic, from which start, held how strongly to n_d."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from pipeline.lights.lobes import values
from pipeline.lights.numerics import FAST, ZERO
from stages.olat.specular import (
    LOBE_FRACTION,
    frame_about,
    optimise,
    reweight,
    start_shape,
    widths,
)

RELATIVE = np.float32(0.2)  # of a sample: model error at which the robust weight falls to a quarter
ABSOLUTE = 0.02  # of the brightest sample: the same for dim samples
ROUND = 0.03  # anisotropy below which a lobe counts as round
DISAGREE = math.cos(math.radians(3.0))  # of n_s and n_d: further apart, n_d is tried as a start
ROUND_STEPS = 3  # Levenberg-Marquardt steps between two reweightings


@njit(cache=True, error_model="numpy")
def fit_lobe(
    settings, o, n_d, solved, half, incident, light, floor, use, area, cosine, weight, g, top, noise, frame, shape, rho
):
    """Fit one pixel's lobe in place on (frame, shape, rho[0]).

    half, incident [3, N], light, floor, use, area (sr), cosine (h·o) [N]: the lights before the surface; weight, g [N]: workspace,
    left with the final weights and the lobe's values; top, noise: brightest sample and deviation; n_d held to where `solved`.
    Returns (gradient norm, passes).
    """
    kind = light.dtype.type
    absolute = kind(ABSOLUTE * top + 3 * noise)
    level = LOBE_FRACTION * top
    samples = (half, incident, light, floor, use, weight, g)
    round_start(light, use, level, area, half, cosine, frame, shape)
    stiff = solved and settings.prior > 0
    cost, passes = _rounds(settings, frame, shape, rho, o, n_d, stiff, absolute, True, samples)
    agree = n_d[0] * frame[2, 0] + n_d[1] * frame[2, 1] + n_d[2] * frame[2, 2]
    if solved and agree < DISAGREE and n_d[0] * o[0] + n_d[1] * o[1] + n_d[2] * o[2] > 0.02:
        frame2, shape2, rho2 = np.empty((3, 3)), shape.copy(), rho.copy()
        frame_about(n_d[0], n_d[1], n_d[2], frame2)
        other, more = _rounds(settings, frame2, shape2, rho2, o, n_d, stiff, absolute, True, samples)
        passes += more
        if other < cost:
            cost, frame[:], shape[:], rho[0] = other, frame2, shape2, rho2[0]
    frame2, shape2, rho2 = frame.copy(), shape.copy(), rho.copy()
    start_shape(light, use, level, area, half, cosine, frame2, shape2)
    shift = 0.5 * (shape[0] + shape[1] - shape2[0] - shape2[1])  # the moments' axes and ratio at the round fit's size
    shape2[0] += shift
    shape2[1] += shift
    shape2[2] *= math.exp(shift)
    other, more = _rounds(settings, frame2, shape2, rho2, o, n_d, stiff, absolute, False, samples)
    passes += more
    large, small, _ = widths(shape2)
    anisotropic = other < settings.gain * cost and (large - small) > ROUND * (large + small)
    if anisotropic:
        frame[:], shape[:], rho[0] = frame2, shape2, rho2[0]
    values(settings.lobe, frame, shape, o, half, incident, g)
    reweight(g, kind(rho[0]), light, use, absolute, RELATIVE, weight)
    stiffness = _stiffness(settings.prior, g, kind(rho[0]), light, use, weight) if stiff else 0.0
    _, norm, more = optimise(settings.lobe, frame, shape, rho, o, half, incident, light, floor, weight, not anisotropic,
                             stiffness, n_d, settings.steps, settings.tolerance)  # fmt: skip
    values(settings.lobe, frame, shape, o, half, incident, g)
    return norm, passes + more


@njit(cache=True, error_model="numpy")
def round_start(light, use, level, area, half, cosine, frame, shape):
    """A round lobe's width from the second moments about the frame's normal."""
    start_shape(light, use, level, area, half, cosine, frame, shape)
    shape[0] = shape[1] = 0.5 * (shape[0] + shape[1])
    shape[2] = 0.0


@njit(cache=True, error_model="numpy")
def _rounds(settings, frame, shape, rho, o, n_d, stiff, absolute, isotropic, samples):
    """Reweighted Levenberg-Marquardt rounds in place; returns the robust cost at their end and the passes."""
    half, incident, light, floor, use, weight, g = samples
    kind = light.dtype.type
    values(settings.lobe, frame, shape, o, half, incident, g)
    rho[0] = linear_albedo(g, light, use, floor)
    passes = 0
    for _ in range(settings.robust):
        reweight(g, kind(rho[0]), light, use, absolute, RELATIVE, weight)
        stiffness = _stiffness(settings.prior, g, kind(rho[0]), light, use, weight) if stiff else 0.0
        _, _, more = optimise(settings.lobe, frame, shape, rho, o, half, incident, light, floor, weight, isotropic,
                              stiffness, n_d, ROUND_STEPS, settings.tolerance)  # fmt: skip
        passes += more
        values(settings.lobe, frame, shape, o, half, incident, g)
    return reweight(g, kind(rho[0]), light, use, absolute, RELATIVE, weight), passes


@njit(cache=True, fastmath=FAST, error_model="numpy")
def _stiffness(prior, g, rho, light, use, weight):
    """Tie to n_d: `prior` times the mean weighted square residual, more where the lobe fits badly; 0 where it fits exactly."""
    s = n = all_s = data = ZERO * rho
    for k in range(g.size):
        r = rho * g[k] - light[k]
        s += weight[k] * r * r
        n += weight[k]
        all_s += use[k] * r * r
        data += use[k] * light[k] * light[k]
    if not (n > ZERO and data > ZERO):
        return 0.0
    return prior * (s / n) * (1.0 + 100.0 * all_s / data)  # doubled where the lobe misses a tenth of the samples


@njit(cache=True, fastmath=FAST, error_model="numpy")
def linear_albedo(g, light, weight, floor):
    """PRF Eq. 17: ratio of two dot products over samples that are not lower bounds."""
    top = bottom = 0.0
    for k in range(g.size):
        w = float(weight[k]) * g[k] if floor[k] == ZERO else 0.0
        top += w * light[k]
        bottom += w * g[k]
    return max(top / bottom, 0.0) if bottom > 0 else 0.0
