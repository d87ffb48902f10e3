"""Which lobe explains a pixel's specular samples: round or anisotropic, from which start, held how strongly to n_d."""

from __future__ import annotations

import math

import numpy as np

from pipeline.kernels.compiling import kernel
from pipeline.kernels.numerics import FAST, ONE, ZERO, copy1, copy2
from pipeline.kernels.scratch import matrix, vector
from pipeline.rig.lobes import values
from stages.olat.pixel_fit.fit_options import ROUND
from stages.olat.pixel_fit.mixed_tangents import LENGTH, SIZE, concentration, fit_mixed, shape_of
from stages.olat.pixel_fit.mixed_uncertainty import mixed_deviation
from stages.olat.pixel_fit.specular import LOBE_FRACTION, frame_about, optimise, reweight, start_shape, widths

RELATIVE = np.float32(0.2)  # of a sample: model error at which the robust weight falls to a quarter
ABSOLUTE = 0.02  # of the brightest sample: the same for dim samples
DISAGREE = math.cos(math.radians(3.0))  # of n_s and n_d: further apart, n_d is tried as a start
MIXED_MISFIT = 0.05**2  # of the samples' square norm: a lobe that misses more may be several
CERTAIN = 18.2
"""By how much two more parameters must lower the cost of n samples that are then fitted by p: `1 / (1 + CERTAIN / (n - p))`.

An F test: one chance in ten thousand where there are many samples. Settings' `gain` is that of 170 lights, and the most there
is; settings' `mixed` is the same for the eight parameters more of mixed tangents.
"""
UNSURE = 0.1**2  # of the square norm, weighted or not: a lobe or a mixture that misses more has no tangent
ROUND_STEPS, DIRECTED_STEPS = 2, 3  # Levenberg-Marquardt steps between two reweightings: round lobe, anisotropic lobe


@kernel(error_model="numpy")
def fit_lobe(settings, o, n_d, prior, solved, half, incident, light, floor, use, area, cosine, weight, g, top, noise,
             frame, shape, rho, equations, workspace):  # fmt: skip
    """Fit one pixel's lobe in place on (frame, shape, rho[0]).

    half, incident [3, N], light, floor, use, area (sr), cosine (h·o) [N]: the lights before the surface; weight, g [N]:
    workspace, left with the final weights and the lobe's values; equations [6, 6]: left with
    one lobe's normal equations (`specular.optimise`); top, noise: brightest sample and deviation; prior: strength of
    the tie to n_d where `solved`, negative where n_d is simply given; workspace: `workspace.Workspace`.
    Returns (gradient norm, passes, order of the tangents: 1 where one lobe is kept, less where they mix, how it ended): of one
    lobe, (what the tie added to the equations' first two diagonal entries, what is left to its minimum, 0, 0, 0, 0), and of a
    mixture what `mixed_uncertainty.mixed_deviation` returns.
    """
    kind = light.dtype.type
    absolute = kind(ABSOLUTE * top + 3 * noise)
    level = LOBE_FRACTION * top
    samples = (half, incident, light, floor, use, weight, g)
    round_start(light, use, level, area, half, cosine, frame, shape)
    frame2, shape2, rho2 = matrix(3, 3), vector(3), vector(1)
    stiff = prior < 0 or (solved and prior > 0)
    cost, passes = _rounds(settings, prior, frame, shape, rho, o, n_d, stiff, absolute, True, samples)
    agree = n_d[0] * frame[2, 0] + n_d[1] * frame[2, 1] + n_d[2] * frame[2, 2]
    if solved and agree < DISAGREE and n_d[0] * o[0] + n_d[1] * o[1] + n_d[2] * o[2] > 0.02:
        copy1(shape, shape2)
        frame_about(n_d[0], n_d[1], n_d[2], frame2)
        other, more = _rounds(settings, prior, frame2, shape2, rho2, o, n_d, stiff, absolute, True, samples)
        passes += more
        if other < cost:
            cost, rho[0] = other, rho2[0]
            copy2(frame2, frame)
            copy1(shape2, shape)
    copy2(frame, frame2)
    start_shape(light, use, level, area, half, cosine, frame2, shape2)
    shift = 0.5 * (shape[0] + shape[1] - shape2[0] - shape2[1])  # the moments' axes and ratio at the round fit's size
    shape2[0] += shift
    shape2[1] += shift
    shape2[2] *= math.exp(shift)
    other, more = _rounds(settings, prior, frame2, shape2, rho2, o, n_d, stiff, absolute, False, samples)
    passes += more
    large, small, _ = widths(shape2)
    anisotropic = other < _gain(settings.gain, use, CERTAIN, 6) * cost and (large - small) > ROUND * (large + small)
    if anisotropic:
        rho[0] = rho2[0]
        copy2(frame2, frame)
        copy1(shape2, shape)
    values(settings.lobe, frame, shape, o, half, incident, g)
    copy1(use, weight)
    if settings.robust > 0:
        reweight(g, kind(rho[0]), light, use, absolute, RELATIVE, weight)
    stiffness = _stiffness(prior, g, kind(rho[0]), light, use, weight) if stiff else 0.0
    left, norm, more = optimise(settings.lobe, frame, shape, rho, o, half, incident, light, floor, weight, not anisotropic,
                             stiffness, n_d, settings.steps, settings.tolerance,
                             equations)  # fmt: skip
    passes += more
    agree = n_d[0] * frame[2, 0] + n_d[1] * frame[2, 1] + n_d[2] * frame[2, 2]
    tied = stiffness * max(agree, 0.5) if stiffness > 0 else 0.0
    values(settings.lobe, frame, shape, o, half, incident, g)
    large, small, angle = widths(shape)
    miss, data, count = _misfit(g, kind(rho[0]), light, floor, use)
    order, ended = 1.0, (tied, left, 0.0, 0.0, 0.0, 0.0)
    if settings.mixed > 0 and prior >= 0 and miss > MIXED_MISFIT * data + _expected(count, noise):
        x = vector(LENGTH)
        copy2(frame, frame2)
        cost = reweight(g, kind(rho[0]), light, use, absolute, RELATIVE, weight)
        tie = _stiffness(prior, g, kind(rho[0]), light, use, weight) if stiff else 0.0
        most = _gain(1.0, use, settings.mixed, SIZE) * cost
        trial, trial_weight = workspace.trial[0, : light.size], workspace.trial[1, : light.size]
        other, more = fit_mixed(settings.lobe, frame2, x, large, small, angle, rho[0], o, half, incident, light, floor, use,
                                absolute, RELATIVE, tie, n_d, settings.tolerance, most, trial_weight,
                                trial, workspace)  # fmt: skip
        passes += more
        total, angle, order2 = concentration(x)
        if other < most and total > 0:
            slope = matrix(2, 3)
            rho[0], order = total, order2
            copy2(frame2, frame)
            shape_of(x[0], x[1], angle, shape, slope)
            for k in range(light.size):
                g[k] = trial[k] / kind(total)
            copy1(trial_weight, weight)
            ended = mixed_deviation(settings.lobe, frame, x, o, half, incident, light, floor, weight, tie, n_d, workspace.spare)
        for weights in (use, weight):
            miss, data, count = _misfit(g, kind(rho[0]), light, floor, weights)
            if miss > UNSURE * data + _expected(count, noise):
                order = 0.0  # what is left is as large as what tells the directions apart
    return norm, passes, order, ended


@kernel(error_model="numpy")
def _expected(count, noise):
    """Square misfit that noise explains, to three standard deviations of its own."""
    return (1.0 + 3.0 * math.sqrt(2.0 / max(count, 1.0))) * count * noise * noise


@kernel(fastmath=FAST, error_model="numpy")
def in_use(use):
    """How many samples are in use."""
    n = ZERO * use[0]
    for k in range(use.size):
        n += ONE if use[k] > ZERO else ZERO
    return float(n)


@kernel(error_model="numpy")
def _gain(most, use, certain, parameters):
    """Share of the simpler lobe's cost that one of `parameters` must beat, for as many samples as are in use."""
    n = in_use(use) - parameters
    return min(most, 1.0 / (1.0 + certain / n)) if n > 0.0 else 0.0


@kernel(fastmath=FAST, error_model="numpy")
def _misfit(g, rho, light, floor, use):
    """Square sums of the residual and of the samples, and the sum of the weights."""
    s = data = n = ZERO * rho
    for k in range(g.size):
        r = rho * g[k] - light[k]
        r = r if floor[k] == ZERO else min(r, ZERO)
        s += use[k] * r * r
        data += use[k] * light[k] * light[k]
        n += use[k]
    return float(s), float(data), float(n)


@kernel(error_model="numpy")
def round_start(light, use, level, area, half, cosine, frame, shape):
    """A round lobe's width from the second moments about the frame's normal."""
    start_shape(light, use, level, area, half, cosine, frame, shape)
    large, small, _ = widths(shape)  # their squares add up to the moment's trace: one sample alone has no second direction
    shape[0] = shape[1] = -0.5 * math.log(0.5 * (large * large + small * small))
    shape[2] = 0.0


@kernel(error_model="numpy")
def _rounds(settings, prior, frame, shape, rho, o, n_d, stiff, absolute, isotropic, samples):
    """Reweighted Levenberg-Marquardt rounds in place; returns the robust cost at their end and the passes."""
    half, incident, light, floor, use, weight, g = samples
    scratch = matrix(6, 6)
    kind = light.dtype.type
    values(settings.lobe, frame, shape, o, half, incident, g)
    rho[0] = linear_albedo(g, light, use, floor)
    passes = 0
    copy1(use, weight)
    for _ in range(max(settings.robust, 1)):
        if settings.robust > 0:
            reweight(g, kind(rho[0]), light, use, absolute, RELATIVE, weight)
        stiffness = _stiffness(prior, g, kind(rho[0]), light, use, weight) if stiff else 0.0
        _, _, more = optimise(settings.lobe, frame, shape, rho, o, half, incident, light, floor, weight, isotropic,
                              stiffness, n_d, ROUND_STEPS if isotropic else DIRECTED_STEPS, settings.tolerance,
                              scratch)  # fmt: skip
        passes += more
        values(settings.lobe, frame, shape, o, half, incident, g)
    return reweight(g, kind(rho[0]), light, use, absolute, RELATIVE, weight), passes


@kernel(fastmath=FAST, error_model="numpy")
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
    if prior < 0:  # the normal is given: a tie that nothing in the samples can stretch
        return 1e8 * data
    return prior * (s / n) * (1.0 + 100.0 * all_s / data)  # doubled where the lobe misses a tenth of the samples


@kernel(fastmath=FAST, error_model="numpy")
def linear_albedo(g, light, weight, floor):
    """PRF Eq. 17: ratio of two dot products over samples that are not lower bounds."""
    top = bottom = 0.0
    for k in range(g.size):
        w = float(weight[k]) * g[k] if floor[k] == ZERO else 0.0
        top += w * light[k]
        bottom += w * g[k]
    return max(top / bottom, 0.0) if bottom > 0 else 0.0
