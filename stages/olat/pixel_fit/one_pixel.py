"""The whole chain for one pixel: separation, diffuse fit, visibility, specular fit, maps, fusion."""

from __future__ import annotations

import math

import numpy as np

from pipeline.kernels.compiling import kernel
from pipeline.kernels.numerics import ONE, copy1
from pipeline.kernels.scratch import matrix, vector
from pipeline.rig.lobes import VIEW_FLOOR, values
from pipeline.rig.map_flags import AWAY, BAD_SAMPLES, BLACK, GOOD, NO_LOBE, SATURATED, TOO_FEW
from stages.olat.pixel_fit.diffuse import channel_albedo, in_use_of
from stages.olat.pixel_fit.fit_options import CORRELATION, JOINT, PARALLEL_ALONE, ROUND
from stages.olat.pixel_fit.form_evidence import doubt
from stages.olat.pixel_fit.gradient_illumination import gradient_maps
from stages.olat.pixel_fit.light_visibility import behind, diffuse_maps, printed_maps, specular_maps
from stages.olat.pixel_fit.lobe_fit import fit_lobe, linear_albedo, round_start
from stages.olat.pixel_fit.overexposure import remove_all
from stages.olat.pixel_fit.paper_forms import correlation, correlation_normal, gradient_direction, lambert
from stages.olat.pixel_fit.result_layout import (
    ALBEDO_D,
    ALBEDO_S,
    ANISOTROPY,
    FLAG,
    NORMAL,
    NORMAL_D,
    NORMAL_S,
    REMOVED,
    RESIDUAL,
    ROUGHNESS,
    SIGMA,
    STD_ALBEDO_D,
    STD_ALBEDO_S,
    STD_NORMAL,
    STD_NORMAL_D,
    STD_NORMAL_S,
    STD_SIGMA,
    TANGENT,
)  # fmt: skip
from stages.olat.pixel_fit.separation import separate
from stages.olat.pixel_fit.specular import LEAST_COSINE, LOBE_FRACTION, frame_about, half_vectors, start_normal, sums, widths
from stages.olat.pixel_fit.uncertainty import (
    NEAREST,
    ONE_WAY,
    albedo_deviation,
    determined,
    direction_deviation,
    strong,
)  # fmt: skip
from stages.olat.pixel_fit.unseparated import diffuse_normal, leave_specular

GAUSSIAN = 1.22  # of the deviation of Gaussian residuals under the diffuse fit's weights: they have 0.82 of it
MOST_UNSURE = 10.0  # relative standard deviation above which nothing is known
BAD_SHARE = 0.1  # of a pixel's samples that may be not finite before the pixel is flagged
NOISE_FLOOR = 1e-3  # of the brightest sample: half floats are this coarse
FIXED = -1.0  # tie of a normal that is not to move
UNKNOWN = 1e6  # variance (rad²) of a normal that was not measured
WIDEST = 2.2  # of a lobe: the width of one that fills the hemisphere (slopes beyond 65 degrees) is not fixed by the samples
LIT_LIGHTS = 4  # three determine a normal and its albedo exactly; only a fourth can contradict them
EFFECTIVE_LIGHTS = 3.0  # a lobe seen by fewer has no width
FAINTEST = 0.01  # of the brightest sample, to count as light of the lobe: below it rounding and inter-reflection would
CERTAIN = 3.0  # standard deviations of the noise above which a sample counts as light
OPPOSITE = 2.0 * float(LEAST_COSINE) ** 2 - 1.0  # cosine of light and view at which h·o is `LEAST_COSINE`
BEYOND = -0.05  # n·o (3 degrees past grazing) below which a normal faces away: smoothed normals at an outline come to that


@kernel(error_model="numpy")
def _gather(workspace, w, area, o, n_d, solved):
    """Lights before the surface, packed; where no normal was found, those not opposite the view (there h = 0)."""
    n, (toward, least) = 0, ((n_d, 0.0) if solved else (o, OPPOSITE))
    for k in range(workspace.diffuse.size):
        p = toward[0] * w[0, k] + toward[1] * w[1, k] + toward[2] * w[2, k]
        workspace.front[n] = k  # written over unless it counts: a branch would be guessed wrong for many lights
        n += 1 if p > least and workspace.ok[k] > 0 else 0
    for j in range(n):
        k = workspace.front[j]
        workspace.light[j] = workspace.specular[k]
        workspace.area[j] = area[k]
        workspace.incident[0, j], workspace.incident[1, j], workspace.incident[2, j] = w[0, k], w[1, k], w[2, k]
        workspace.bound[j] = workspace.floor[k]
        workspace.seen[j] = workspace.use[k] if solved else ONE
    return n


@kernel(error_model="numpy")
def fit_pixel(cross, parallel, w, o, area, energy, gains, settings, workspace, out):
    """Fill `out` [WIDTH] for one pixel from its samples cross, parallel [3, N] (N lights at directions w [3, N]).

    o [3]: unit, to the camera; area [N]: solid angles (sr); energy [N]: relative irradiance of each light,
    gains [3, N] make it white. `out[FLAG]` says how far the row is to be trusted; it never holds anything
    that is not finite. Returns (specular gradient norm, passes).
    """
    kind = energy.dtype.type
    for k in range(out.size):
        out[k] = 0.0
    count = energy.size
    level = settings.saturation
    if settings.remove and level < np.inf:
        remove_all(cross, parallel, settings, workspace.front, out[REMOVED:])
        level = np.inf
    bad, clipped, top_d, top_s = separate(cross, parallel, energy, gains, settings, kind(level), workspace)
    flag = BAD_SAMPLES if bad > BAD_SHARE * count else GOOD
    if not (top_d > 0 or top_s > 0):
        out[FLAG] = SATURATED if clipped * 2 > count else (BLACK if flag == GOOD else flag)
        for k in range(3):
            out[NORMAL_D + k] = out[NORMAL_S + k] = out[NORMAL + k] = o[k]
        return 0.0, 0

    if settings.gradient:
        n = _gather(workspace, w, area, (o[0], o[1], o[2]), (o[0], o[1], o[2]), False)
        gradient_maps(n, workspace, w, o, area, flag, out)
        return 0.0, 0

    # diffuse
    mx, my, mz, scale, _, solved = diffuse_normal(workspace, w, settings)
    size = math.sqrt(mx * mx + my * my + mz * mz)
    solved = solved and size > 0
    n_d = (o[0], o[1], o[2])
    square_d = data_d = 0.0
    angle_d = math.pi  # root mean square error
    variance_d = UNKNOWN
    if solved:
        n_d = (mx / size, my / size, mz / size)
        nx, ny, nz = kind(n_d[0]), kind(n_d[1]), kind(n_d[2])
        channel_albedo(workspace.rgb, w[0], w[1], w[2], nx, ny, nz, workspace.weight, out[ALBEDO_D:])
        for k in range(3):
            out[ALBEDO_D + k] = max(out[ALBEDO_D + k], 0.0)
        in_use, lit = in_use_of(workspace.weight)
        if lit < LIT_LIGHTS and flag == GOOD:
            flag = TOO_FEW  # solved, but with nothing to spare
        variance_d = (scale / size) ** 2 * 3.0 / max(in_use, 1.0)
        angle_d = direction_deviation(workspace.weight, w, n_d, scale, size)
        out[STD_ALBEDO_D] = GAUSSIAN * albedo_deviation(workspace.rgb, workspace.weight, w[0], w[1], w[2], nx, ny, nz,
                                                        out[ALBEDO_D], out[ALBEDO_D + 1], out[ALBEDO_D + 2])  # fmt: skip
        if settings.one_pass >= PARALLEL_ALONE:
            leave_specular(workspace.diffuse, workspace.ok, w[0], w[1], w[2], kind(mx), kind(my), kind(mz),
                           kind(CERTAIN * scale), kind(1.0 / math.pi), workspace.specular)  # fmt: skip
        zeta = 2 * behind(workspace.diffuse, workspace.ok, w[0], w[1], w[2], nx, ny, nz) + NOISE_FLOOR * top_d
        square_d, data_d = diffuse_maps(workspace, w, area, n_d, size, zeta, out)
        if settings.printed_maps:
            printed_maps(workspace.diffuse, workspace, w, n_d, zeta, out, False)
    elif flag == GOOD:
        flag = SATURATED if clipped * 2 > count else TOO_FEW
        x, y, z, found = gradient_direction(workspace.diffuse, workspace.ok, w, area)
        if found:
            n_d = (x, y, z)
    for k in range(3):
        out[NORMAL_D + k] = n_d[k]

    # specular
    n = _gather(workspace, w, area, (o[0], o[1], o[2]), n_d, solved)
    norm, passes, variance_s, square_s, data_s = 0.0, 0, UNKNOWN, 0.0, 0.0
    out[STD_NORMAL_S] = math.pi
    fitted = False
    n_s = n_d
    if n >= 3:
        fitted, n_s, norm, passes, variance_s, square_s, data_s, lobe_flag = _specular(
            n, w, o, area, settings, n_d, solved, top_d, workspace, out
        )
        flag = lobe_flag if flag == GOOD else flag
    elif flag == GOOD:
        flag = TOO_FEW
    for k in range(3):
        out[NORMAL_S + k] = n_s[k]
    if not solved and fitted:
        n_d = n_s
        for k in range(3):
            out[NORMAL_D + k] = n_s[k]
        angle_d = out[STD_NORMAL_S]
    if not fitted:
        out[STD_NORMAL_S] = angle_d

    a, b = 1.0 / variance_d, 1.0 / variance_s
    if settings.fuse_correlation and solved and fitted:
        lambert(n_d, w, workspace.scratch)
        a = correlation(workspace.scratch, workspace.diffuse, workspace.use)
        b = correlation(workspace.lobe[:n], workspace.light[:n], workspace.seen[:n])
    _fuse(n_d, n_s, a, b, angle_d, out)
    facing = out[NORMAL] * o[0] + out[NORMAL + 1] * o[1] + out[NORMAL + 2] * o[2]
    if facing < BEYOND and flag != SATURATED and flag != BAD_SAMPLES:
        flag = AWAY
    data = data_d / (math.pi * math.pi) + data_s
    out[RESIDUAL] = math.sqrt((square_d / (math.pi * math.pi) + square_s) / data) if data > 0 else 0.0
    out[FLAG] = flag
    for k in range(out.size):  # overflow of absurd samples: nothing that is not finite leaves this function
        if not math.isfinite(out[k]):
            out[k] = 0.0
            out[FLAG] = BAD_SAMPLES
    if out[FLAG] == BAD_SAMPLES:
        for at in (NORMAL_D, NORMAL_S, NORMAL):
            if out[at] == 0 and out[at + 1] == 0 and out[at + 2] == 0:
                out[at], out[at + 1], out[at + 2] = o[0], o[1], o[2]
    return norm, passes


@kernel(error_model="numpy")
def _fuse(n_d, n_s, a, b, angle_d, out):
    """The mean of the normals by weights a and b, and the standard deviations (degrees) of all three."""
    angle_s = out[STD_NORMAL_S]
    out[STD_NORMAL_D], out[STD_NORMAL_S] = math.degrees(angle_d), math.degrees(angle_s)
    out[STD_NORMAL] = math.degrees(math.sqrt((a * angle_d) ** 2 + (b * angle_s) ** 2) / (a + b)) if a + b > 0 else 180.0
    x, y, z = a * n_d[0] + b * n_s[0], a * n_d[1] + b * n_s[1], a * n_d[2] + b * n_s[2]
    length = math.sqrt(x * x + y * y + z * z)
    if length > 0:
        out[NORMAL], out[NORMAL + 1], out[NORMAL + 2] = x / length, y / length, z / length
    else:
        out[NORMAL], out[NORMAL + 1], out[NORMAL + 2] = n_d[0], n_d[1], n_d[2]


@kernel(error_model="numpy")
def _unsure(flag, albedo, width, variance, large, small, out):
    """Standard deviations of a lobe from those of its logarithms: what is not known is off by as much as it is."""
    if flag != GOOD:
        albedo, width = max(albedo, 1.0), max(width, 1.0)
        out[STD_NORMAL_S] = min(math.sqrt(2.0 * variance), math.pi)
    out[STD_ALBEDO_S] = min(albedo, MOST_UNSURE) * out[ALBEDO_S]
    out[STD_SIGMA] = min(width, MOST_UNSURE) * math.sqrt(0.5 * (large * large + small * small))


@kernel(error_model="numpy")
def _brightest(top, large, small, frame, o):
    """Albedo of a lobe no brighter at its peak than the brightest sample extrapolated over the `NEAREST` widths allowed."""
    facing = max(frame[2, 0] * o[0] + frame[2, 1] * o[1] + frame[2, 2] * o[2], VIEW_FLOOR)
    return top * math.exp(NEAREST * NEAREST) * 4.0 * math.pi * min(large * small, WIDEST * WIDEST) * facing


@kernel(error_model="numpy")
def _specular(n, w, o, area, settings, n_d, solved, top_d, workspace, out):
    """Specular part of a pixel: what can be fitted, the fit, its maps. See `fit_pixel`."""
    kind = area.dtype.type
    light, use, floor, areas = workspace.light[:n], workspace.seen[:n], workspace.bound[:n], workspace.area[:n]
    cosine, weight, g = workspace.cosine[:n], workspace.work[:n], workspace.lobe[:n]
    half = (workspace.half[0, :n], workspace.half[1, :n], workspace.half[2, :n])
    incident = (workspace.incident[0, :n], workspace.incident[1, :n], workspace.incident[2, :n])
    half_vectors(incident[0], incident[1], incident[2], kind(o[0]), kind(o[1]), kind(o[2]), half[0], half[1], half[2], cosine)
    top, whole, squares, clipped, noise = sums(light, use, floor)
    nothing = (False, n_d, 0.0, 0, UNKNOWN, 0.0, 0.0, NO_LOBE)
    if not (top > 5 * noise and top > 1e-4 * top_d):
        return nothing
    x, y, z, samples = start_normal(light, use, LOBE_FRACTION * top, areas, half, cosine)
    if samples == 0:
        return nothing
    if x * o[0] + y * o[1] + z * o[2] < 0.02 and solved:
        x, y, z = n_d
    frame, shape, rho, equations = matrix(3, 3), vector(3), vector(1), matrix(6, 6)
    tie, tied = settings.prior, n_d
    if settings.specular_fit == CORRELATION:
        a, b, c, found = correlation_normal(light, use, incident, o, weight)
        if found and a * o[0] + b * o[1] + c * o[2] > 0.02:
            x, y, z = a, b, c
    if settings.specular_fit != JOINT:
        tie, tied, solved = FIXED, (x, y, z), False
    frame_about(x, y, z, frame)
    norm, passes, order, ended, unsure_albedo, unsure_width = 0.0, 0, 1.0, (0.0, 0.0, 0.0, 0.0, 0.0, 0.0), 1.0, 1.0
    flag = SATURATED if clipped > 0.5 * whole else GOOD
    light_sum, light_squares = strong(light, use, kind(max(FAINTEST * top, CERTAIN * noise)))
    fits = light_sum * light_sum >= EFFECTIVE_LIGHTS * light_squares
    if not fits:  # too narrow for the rig, or all but hidden: half vectors, moments, no fit
        flag = TOO_FEW if flag == GOOD else flag
        if solved and clipped == 0 and samples < EFFECTIVE_LIGHTS:
            frame_about(n_d[0], n_d[1], n_d[2], frame)
        round_start(light, use, LOBE_FRACTION * top, areas, half, cosine, frame, shape)  # about the normal that is kept
        values(settings.lobe, frame, shape, o, half, incident, g)
        copy1(use, weight)
    else:
        norm, passes, order, ended = fit_lobe(settings, o, tied, tie, solved, half, incident, light, floor, use, areas, cosine,
                                              weight, g, top, noise, frame, shape, rho, equations, workspace)  # fmt: skip
    rho[0] = linear_albedo(g, light, weight, floor) if order == 1.0 else rho[0]
    large, small, angle = widths(shape)
    if not (math.isfinite(large) and math.isfinite(small) and math.isfinite(rho[0]) and math.isfinite(frame[2, 0])):
        return nothing
    if large > WIDEST or not rho[0] > 0:
        flag = NO_LOBE
    elif fits and flag == GOOD:
        form = doubt(settings, light_sum * light_sum / light_squares, frame, shape, rho[0], ended[0], o, tied, half, incident,
                     light, floor, use, g, top, noise, workspace)  # fmt: skip
        flag, unsure_albedo, unsure_width, out[STD_NORMAL_S] = determined(
            frame, shape, rho[0], order, ended, equations, form, half, light, floor, use, weight, g, top, tie < 0)  # fmt: skip
    found, bounded = rho[0], fits and flag != GOOD and flag != SATURATED
    rho[0] = min(found, _brightest(top, large, small, frame, o)) if bounded else found
    out[ALBEDO_S] = rho[0]
    out[SIGMA], out[SIGMA + 1] = large, small
    out[ROUGHNESS] = (large * small) ** 0.25
    out[ANISOTROPY] = (large - small) / (large + small)
    if out[ANISOTROPY] > ROUND and order > ONE_WAY:
        for k in range(3):
            out[TANGENT + k] = math.cos(angle) * frame[0, k] + math.sin(angle) * frame[1, k]
    n_s = (frame[2, 0], frame[2, 1], frame[2, 2])
    zeta = 2 * noise + 0.01 * top
    square, data = specular_maps(workspace, n, g, rho[0], found, zeta, area, w, n_s, out)
    if settings.printed_maps:
        printed_maps(workspace.specular, workspace, w, n_s, zeta, out, True)
    in_lobe = max(whole * whole / squares, 1.0)
    variance = (square / max(data, 1e-30) + 1e-6) * large * small / in_lobe + (1.0 if flag != GOOD else 0.0)
    _unsure(flag, unsure_albedo, unsure_width, variance, large, small, out)
    return True, n_s, norm, passes, variance, square, data, flag
