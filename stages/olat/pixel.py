"""The whole chain for one pixel: separation, diffuse fit, visibility, specular fit, maps, fusion."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from pipeline.lights.lobes import values
from pipeline.lights.numerics import FAST, HALF, ONE, ZERO
from stages.olat.diffuse import fit_normal
from stages.olat.lobe_fit import ROUND, fit_lobe, linear_albedo, round_start
from stages.olat.paper import (
    CORRELATION,
    JOINT,
    correlation,
    correlation_normal,
    gradient_direction,
    lambert,
    remove_overexposure,
    total,
)
from stages.olat.specular import LOBE_FRACTION, SIGMA_MAX, frame_about, half_vectors, start_normal, widths

GOOD, TOO_FEW, SATURATED, BLACK, NO_LOBE, BAD_SAMPLES = range(6)
BAD_SHARE = 0.1  # of a pixel's samples that may be not finite before the pixel is flagged
NOISE_FLOOR = 1e-3  # of the brightest sample: half floats are this coarse
FIXED = -1.0  # tie of a normal that is not to move
UNKNOWN = 1e6  # variance (rad²) of a normal that was not measured
ONE_WAY = 0.75  # order of a pixel's tangents below which it has no one tangent
LIT_LIGHTS = 4  # three determine a normal and its albedo exactly; only a fourth can contradict them
EFFECTIVE_LIGHTS = 3.0  # a lobe seen by fewer has no width

MAPS = {
    "diffuse_albedo": ("R", "G", "B"),
    "specular_albedo": ("Y",),
    "diffuse_normal": ("X", "Y", "Z"),
    "specular_normal": ("X", "Y", "Z"),
    "normal": ("X", "Y", "Z"),
    "tangent": ("X", "Y", "Z"),
    "sigma": ("X", "Y"),
    "roughness": ("Y",),
    "anisotropy": ("Y",),
    "occlusion_d": ("Y",),
    "occlusion_s": ("Y",),
    "visibility_d": ("Y",),
    "visibility_s": ("Y",),
    "interreflection_d": ("R", "G", "B"),
    "interreflection_s": ("Y",),
    "residual": ("Y", "flag"),
}
"""Maps of one camera and their channels, in the order of a pixel's row of results."""


def columns() -> dict[str, slice]:
    """Where each map lies in a pixel's row."""
    out, at = {}, 0
    for name, channels in MAPS.items():
        out[name] = slice(at, at + len(channels))
        at += len(channels)
    return out


_AT = {name: place.start for name, place in columns().items()}
ALBEDO_D, ALBEDO_S, NORMAL_D, NORMAL_S = (
    _AT[n] for n in ("diffuse_albedo", "specular_albedo", "diffuse_normal", "specular_normal")
)
NORMAL, TANGENT, SIGMA, ROUGHNESS = (_AT[n] for n in ("normal", "tangent", "sigma", "roughness"))
ANISOTROPY, OCCLUSION_D, OCCLUSION_S = (_AT[n] for n in ("anisotropy", "occlusion_d", "occlusion_s"))
VISIBILITY_D, VISIBILITY_S = _AT["visibility_d"], _AT["visibility_s"]
INTER_D, INTER_S, RESIDUAL = (_AT[n] for n in ("interreflection_d", "interreflection_s", "residual"))
FLAG = RESIDUAL + 1
WIDTH = FLAG + 1


class Settings(NamedTuple):
    """What the kernels need to know; plain numbers, so that numba can take it."""

    lobe: int
    rounds: int  # reweighting rounds of the diffuse fit
    robust: int  # reweighting rounds of the specular fit
    steps: int  # Levenberg-Marquardt steps at the end
    tolerance: float  # gradient norm, data of unit norm, at which a fit ends
    saturation: float  # radiance from which a sample is clipped (inf: none is)
    specular_factor: float
    irradiance: float
    gain: float  # share of the round lobe's robust cost that an anisotropic one must beat
    mixed: float  # share of one lobe's robust cost that mixed tangents must beat (0: never tried)
    prior: float  # strength of the tie of n_s to n_d: inverse square of the angle (rad) they may differ by
    plain: bool  # diffuse fit without robust weights (PRF Eq. 12)
    specular_fit: int  # how n_s is found, `paper.SPECULAR_FITS`
    fuse_correlation: bool  # fuse the normals by correlation (PRF) instead of inverse variance
    printed_maps: bool  # occlusion and inter-reflection as PRF Eqs. 4 and 5 print them
    remove: bool  # clipped samples by PRF Algorithm 1 instead of as bounds
    gradient: bool  # gradient illumination alone (Ma et al. 2007)


class Room(NamedTuple):
    """Workspace of one thread for pixels with N lights."""

    rgb: np.ndarray  # [3, N] I_d in albedo units
    diffuse: np.ndarray  # [N] their mean
    specular: np.ndarray  # [N] I_s per unit irradiance
    ok: np.ndarray
    use: np.ndarray
    floor: np.ndarray
    weight: np.ndarray
    work: np.ndarray
    scratch: np.ndarray
    front: np.ndarray  # [N] indices of the lights before the surface
    light: np.ndarray  # [N] and below: the same lights' samples, packed
    area: np.ndarray
    cosine: np.ndarray
    seen: np.ndarray
    bound: np.ndarray
    lobe: np.ndarray
    incident: np.ndarray  # [3, N]
    half: np.ndarray  # [3, N]


@njit(cache=True, error_model="numpy")
def make_room(n, like):
    """Workspace for `n` lights in the precision of the array `like`."""
    one = np.zeros((14, n), like.dtype)
    return Room(
        np.zeros((3, n), like.dtype), one[0], one[1], one[2], one[3], one[4], one[5], one[6], one[7],
        np.zeros(n, np.int64), one[8], one[9], one[10], one[11], one[12], one[13],
        np.zeros((3, n), like.dtype), np.zeros((3, n), like.dtype),
    )  # fmt: skip


@njit(cache=True, fastmath=FAST, error_model="numpy")
def separate(cross, parallel, energy, settings, level, room):
    """I_d = 2 I_x and I_s = f (I_p - I_x) per unit of irradiance; marks samples that are not finite or clipped.

    cross, parallel [3, N]. Returns (samples that are bad, clipped, brightest diffuse, brightest specular).
    """
    kind = energy.dtype.type
    scale_d = kind(2.0 * math.pi / settings.irradiance)
    scale_s = kind(settings.specular_factor / (3.0 * settings.irradiance))
    third = kind(1.0 / 3.0)
    bad = clipped = 0
    top_d = top_s = ZERO * energy[0]
    for k in range(energy.size):
        r, g, b = cross[0, k], cross[1, k], cross[2, k]
        x, y, z = parallel[0, k], parallel[1, k], parallel[2, k]
        total = r + g + b + x + y + z
        fine = abs(total) < kind(1e30)  # false for NaN and Inf
        clip_x = max(r, g, b) >= level
        clip_p = max(x, y, z) >= level
        e = ONE / energy[k] if fine else ZERO
        if not fine:
            r = g = b = x = y = z = ZERO
            bad += 1
        if clip_x or clip_p:
            clipped += 1
        d = scale_d * e
        room.rgb[0, k], room.rgb[1, k], room.rgb[2, k] = d * r, d * g, d * b
        mean = d * (r + g + b) * third
        room.diffuse[k] = mean
        s = scale_s * e * (x + y + z - r - g - b)
        room.specular[k] = s
        room.ok[k] = ONE if fine and not clip_x else ZERO
        room.floor[k] = ONE if clip_p else ZERO
        top_d = max(top_d, mean if fine else ZERO)
        top_s = max(top_s, s)
    return bad, clipped, top_d, top_s


@njit(cache=True, fastmath=FAST, error_model="numpy")
def _albedo(rgb, diffuse, wx, wy, wz, nx, ny, nz, weight, out):
    """PRF Eq. 16: ratio of two dot products over the lights in use; `out` [3] is filled. Returns the residual's square sums."""
    r = g = b = den = ZERO * nx
    for k in range(weight.size):
        p = nx * wx[k] + ny * wy[k] + nz * wz[k]
        w = weight[k] * p
        r += w * rgb[0, k]
        g += w * rgb[1, k]
        b += w * rgb[2, k]
        den += w * p
    if den > ZERO:
        out[0], out[1], out[2] = r / den, g / den, b / den
    else:
        out[0] = out[1] = out[2] = ZERO


@njit(cache=True, fastmath=FAST, error_model="numpy")
def _behind(light, ok, wx, wy, wz, nx, ny, nz):
    """Root mean square of the samples whose light is behind the surface: noise and inter-reflection."""
    s = n = ZERO * nx
    for k in range(light.size):
        p = nx * wx[k] + ny * wy[k] + nz * wz[k]
        w = ok[k] if p < -HALF * HALF else ZERO
        s += w * light[k] * light[k]
        n += w
    return math.sqrt(s / n) if n > ZERO else ZERO


@njit(cache=True, error_model="numpy")
def _diffuse_maps(room, w, area, nx, ny, nz, albedo, zeta, out):
    """Visibility, occlusion (Eq. 5, normalised by the rig's own unoccluded sum), inter-reflection (Eq. 4)."""
    seen = front = lit = whole = 0.0
    r = g = b = 0.0
    square = data = 0.0
    for k in range(area.size):
        p = nx * w[0, k] + ny * w[1, k] + nz * w[2, k]
        v = room.diffuse[k]
        if p > 0:
            front += 1
            whole += p * area[k]
            visible = v > 0.5 * albedo * p or albedo * p < 2 * zeta
            if room.ok[k] == 0:  # clipped: surely lit; not finite: unknown, counted as lit
                visible = True
            room.use[k] = ONE if visible else ZERO
            if visible:
                seen += 1
                lit += p * area[k]
                if room.ok[k] > 0:
                    square += (v - albedo * p) ** 2
                    data += v * v
        else:
            room.use[k] = ZERO
            if room.ok[k] > 0 and v > zeta:
                e = -p * area[k] / math.pi
                r += e * room.rgb[0, k]
                g += e * room.rgb[1, k]
                b += e * room.rgb[2, k]
    out[VISIBILITY_D] = seen / front if front > 0 else 0.0
    out[OCCLUSION_D] = lit / whole if whole > 0 else 0.0
    out[INTER_D], out[INTER_D + 1], out[INTER_D + 2] = max(r, 0.0), max(g, 0.0), max(b, 0.0)
    return square, data


@njit(cache=True, error_model="numpy")
def _specular_maps(room, n, g, rho, zeta, all_area, w, nx, ny, nz, out):
    """Share of the lobe's lights and energy that arrives, and what arrives from behind; returns residual sums."""
    seen = expected = lit = whole = 0.0
    square = data = 0.0
    for k in range(n):
        p, v = rho * g[k], room.light[k]
        whole += p * room.area[k]
        arrives = v > 0.5 * p or p < 2 * zeta
        if arrives:
            lit += p * room.area[k]
        if p > 2 * zeta:
            expected += 1
            seen += 1 if arrives else 0
        if room.seen[k] > 0 and not (room.bound[k] > 0 and p > v):
            square += (v - p) ** 2
            data += v * v
    out[VISIBILITY_S] = seen / expected if expected > 0 else 0.0
    out[OCCLUSION_S] = lit / whole if whole > 0 else 0.0
    s = 0.0
    for k in range(all_area.size):
        p = nx * w[0, k] + ny * w[1, k] + nz * w[2, k]
        if p < 0 and room.ok[k] > 0 and room.specular[k] > zeta:
            s -= p * all_area[k] * room.specular[k]
    out[INTER_S] = max(s, 0.0)
    return square, data


@njit(cache=True, error_model="numpy")
def _printed_maps(light, room, w, n, zeta, out, specular):
    """PRF Eqs. 4 and 5 as printed: every light counts alike, 4/N normalises, `I > zeta` is visible."""
    lit = seen = front = r = g = b = 0.0
    for k in range(light.size):
        p = n[0] * w[0, k] + n[1] * w[1, k] + n[2] * w[2, k]
        arrives = light[k] > zeta and room.ok[k] > 0
        if p > 0:
            front += 1
            if arrives:
                seen += 1
                lit += p
        elif arrives:
            r -= p * (light[k] if specular else room.rgb[0, k])
            g -= p * room.rgb[1, k]
            b -= p * room.rgb[2, k]
    visible = seen / front if front > 0 else 0.0
    if specular:
        out[OCCLUSION_S], out[VISIBILITY_S], out[INTER_S] = 4 * lit / light.size, visible, max(r, 0.0)
    else:
        out[OCCLUSION_D], out[VISIBILITY_D] = 4 * lit / light.size, visible
        out[INTER_D], out[INTER_D + 1], out[INTER_D + 2] = max(r, 0.0), max(g, 0.0), max(b, 0.0)


@njit(cache=True, error_model="numpy")
def _gather(room, w, area, n_d, solved):
    """Lights before the surface, packed: their directions, half vectors, samples and whether they are seen."""
    n = 0
    for k in range(room.diffuse.size):
        p = n_d[0] * w[0, k] + n_d[1] * w[1, k] + n_d[2] * w[2, k]
        if (p > 0 or not solved) and room.ok[k] > 0:
            room.front[n] = k
            n += 1
    for j in range(n):
        k = room.front[j]
        room.light[j] = room.specular[k]
        room.area[j] = area[k]
        room.incident[0, j], room.incident[1, j], room.incident[2, j] = w[0, k], w[1, k], w[2, k]
        room.bound[j] = room.floor[k]
        room.seen[j] = room.use[k] if solved else ONE
    return n


@njit(cache=True, error_model="numpy")
def fit_pixel(cross, parallel, w, o, area, energy, settings, room, out):
    """Fill `out` [WIDTH] for one pixel from its samples cross, parallel [3, N] (N lights at directions w [3, N]).

    o [3]: unit, to the camera; area [N]: solid angles (sr); energy [N]: relative irradiance of each light. `out[FLAG]` says how
    far the row is to be trusted; it never holds anything that is not finite. Returns (specular gradient norm, passes).
    """
    kind = energy.dtype.type
    for k in range(out.size):
        out[k] = 0.0
    count = energy.size
    level = settings.saturation
    if settings.remove and level < np.inf:
        for c in range(3):
            delta = kind(max(np.mean(parallel[c]), 0.0))
            remove_overexposure(cross[c], level, room.front, delta)
            remove_overexposure(parallel[c], level, room.front, delta)
        level = np.inf
    bad, clipped, top_d, top_s = separate(cross, parallel, energy, settings, kind(level), room)
    flag = BAD_SAMPLES if bad > BAD_SHARE * count else GOOD
    if not (top_d > 0 or top_s > 0):
        out[FLAG] = SATURATED if clipped * 2 > count else (BLACK if flag == GOOD else flag)
        for k in range(3):
            out[NORMAL_D + k] = out[NORMAL_S + k] = out[NORMAL + k] = o[k]
        return 0.0, 0

    if settings.gradient:
        _gradient(room, w, o, area, flag, out)
        return 0.0, 0

    # diffuse
    mx, my, mz, scale, _, solved = fit_normal(
        room.diffuse, room.ok, w[0], w[1], w[2], settings.rounds, settings.plain, room.weight, room.work, room.scratch
    )
    size = math.sqrt(mx * mx + my * my + mz * mz)
    solved = solved and size > 0
    n_d = (o[0], o[1], o[2])
    square_d = data_d = 0.0
    variance_d = UNKNOWN
    if solved:
        n_d = (mx / size, my / size, mz / size)
        nx, ny, nz = kind(n_d[0]), kind(n_d[1]), kind(n_d[2])
        _albedo(room.rgb, room.diffuse, w[0], w[1], w[2], nx, ny, nz, room.weight, out[ALBEDO_D:])
        for k in range(3):
            out[ALBEDO_D + k] = max(out[ALBEDO_D + k], 0.0)
        in_use = 0.0
        lit = 0
        for k in range(count):
            in_use += room.weight[k]
            lit += 1 if room.weight[k] > 0.25 else 0
        if lit < LIT_LIGHTS and flag == GOOD:
            flag = TOO_FEW  # solved, but with nothing to spare
        variance_d = (scale / size) ** 2 * 3.0 / max(in_use, 1.0)
        zeta = 2 * _behind(room.diffuse, room.ok, w[0], w[1], w[2], nx, ny, nz) + NOISE_FLOOR * top_d
        square_d, data_d = _diffuse_maps(room, w, area, n_d[0], n_d[1], n_d[2], size, zeta, out)
        if settings.printed_maps:
            _printed_maps(room.diffuse, room, w, n_d, zeta, out, False)
    elif flag == GOOD:
        flag = SATURATED if clipped * 2 > count else TOO_FEW
        x, y, z, found = gradient_direction(room.diffuse, room.ok, w, area)
        if found:
            n_d = (x, y, z)
    for k in range(3):
        out[NORMAL_D + k] = n_d[k]

    # specular
    n = _gather(room, w, area, n_d, solved)
    norm, passes, variance_s, square_s, data_s = 0.0, 0, UNKNOWN, 0.0, 0.0
    fitted = False
    n_s = n_d
    if n >= 3:
        fitted, n_s, norm, passes, variance_s, square_s, data_s, lobe_flag = _specular(
            n, w, o, area, settings, n_d, solved, top_d, room, out
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

    a, b = 1.0 / variance_d, 1.0 / variance_s
    if settings.fuse_correlation and solved and fitted:
        lambert(n_d, w, room.scratch)
        a = correlation(room.scratch, room.diffuse, room.use)
        b = correlation(room.lobe[:n], room.light[:n], room.seen[:n])
    x, y, z = a * n_d[0] + b * n_s[0], a * n_d[1] + b * n_s[1], a * n_d[2] + b * n_s[2]
    length = math.sqrt(x * x + y * y + z * z)
    if length > 0:
        out[NORMAL], out[NORMAL + 1], out[NORMAL + 2] = x / length, y / length, z / length
    else:
        out[NORMAL], out[NORMAL + 1], out[NORMAL + 2] = n_d[0], n_d[1], n_d[2]
    data = data_d / (math.pi * math.pi) + data_s
    out[RESIDUAL] = math.sqrt((square_d / (math.pi * math.pi) + square_s) / data) if data > 0 else 0.0
    out[FLAG] = flag
    for k in range(out.size):  # overflow of absurd samples: nothing that is not finite leaves this function
        if not math.isfinite(out[k]):
            out[k] = 0.0
            out[FLAG] = BAD_SAMPLES
    return norm, passes


@njit(cache=True, error_model="numpy")
def _gradient(room, w, o, area, flag, out):
    """Ma et al. 2007: normals from the three gradients, albedos from the sums; no lobe, no refinement."""
    x, y, z, found = gradient_direction(room.diffuse, room.ok, w, area)
    n = (x, y, z) if found else (o[0], o[1], o[2])
    x, y, z, shines = gradient_direction(room.specular, room.ok, w, area)
    x, y, z = x + o[0], y + o[1], z + o[2]
    size = math.sqrt(x * x + y * y + z * z)
    m = (x / size, y / size, z / size) if shines and size > 1e-6 else n
    for k in range(3):
        out[NORMAL_D + k], out[NORMAL_S + k], out[NORMAL + k] = n[k], m[k], n[k]
        out[ALBEDO_D + k] = max(total(room.rgb[k], room.ok, area) / math.pi, 0.0)
    out[ALBEDO_S] = max(total(room.specular, room.ok, area), 0.0)
    out[FLAG] = flag if found else TOO_FEW


@njit(cache=True, error_model="numpy")
def _specular(n, w, o, area, settings, n_d, solved, top_d, room, out):
    """Specular part of a pixel: what can be fitted, the fit, its maps. See `fit_pixel`."""
    kind = area.dtype.type
    light, use, floor, areas = room.light[:n], room.seen[:n], room.bound[:n], room.area[:n]
    cosine, weight, g = room.cosine[:n], room.work[:n], room.lobe[:n]
    half = (room.half[0, :n], room.half[1, :n], room.half[2, :n])
    incident = (room.incident[0, :n], room.incident[1, :n], room.incident[2, :n])
    half_vectors(incident[0], incident[1], incident[2], kind(o[0]), kind(o[1]), kind(o[2]), half[0], half[1], half[2], cosine)
    top = noise = whole = squares = clipped = negative = 0.0
    for j in range(n):
        v = light[j]
        if v < 0:
            noise += v * v
            negative += 1
        elif use[j] > 0:
            top = max(top, v)
            whole += v
            squares += v * v
            clipped += v if floor[j] > 0 else 0.0
    noise = math.sqrt(noise / negative) if negative > 0 else 0.0
    nothing = (False, n_d, 0.0, 0, UNKNOWN, 0.0, 0.0, NO_LOBE)
    if not (top > 5 * noise and top > 1e-4 * top_d):
        return nothing
    x, y, z, samples = start_normal(light, use, LOBE_FRACTION * top, areas, half, cosine)
    if samples == 0:
        return nothing
    if x * o[0] + y * o[1] + z * o[2] < 0.02 and solved:
        x, y, z = n_d
    frame, shape, rho = np.empty((3, 3)), np.empty(3), np.empty(1)
    tie, tied = settings.prior, n_d
    if settings.specular_fit == CORRELATION:
        a, b, c, found = correlation_normal(light, use, incident, o)
        if found and a * o[0] + b * o[1] + c * o[2] > 0.02:
            x, y, z = a, b, c
    if settings.specular_fit != JOINT:
        tie, tied, solved = FIXED, (x, y, z), False
    frame_about(x, y, z, frame)
    flag, norm, passes, order = GOOD, 0.0, 0, 1.0
    if clipped > 0.5 * whole:
        flag = SATURATED
    if whole * whole < EFFECTIVE_LIGHTS * squares:  # too narrow for the rig, or all but hidden: half vectors, moments, no fit
        flag = TOO_FEW if flag == GOOD else flag
        round_start(light, use, LOBE_FRACTION * top, areas, half, cosine, frame, shape)
        if solved and clipped == 0 and samples < EFFECTIVE_LIGHTS:
            frame_about(n_d[0], n_d[1], n_d[2], frame)
        values(settings.lobe, frame, shape, o, half, incident, g)
        for j in range(n):
            weight[j] = use[j]
    else:
        norm, passes, order = fit_lobe(settings, o, tied, tie, solved, half, incident, light, floor, use, areas, cosine, weight,
                                       g, top, noise, frame, shape, rho)  # fmt: skip
    rho[0] = linear_albedo(g, light, weight, floor) if order == 1.0 else rho[0]
    large, small, angle = widths(shape)
    if not (math.isfinite(large) and math.isfinite(small) and math.isfinite(rho[0]) and math.isfinite(frame[2, 0])):
        return nothing
    if large >= 0.99 * SIGMA_MAX or not rho[0] > 0:
        flag = NO_LOBE
    out[ALBEDO_S] = rho[0]
    out[SIGMA], out[SIGMA + 1] = large, small
    out[ROUGHNESS] = (large * small) ** 0.25
    out[ANISOTROPY] = (large - small) / (large + small)
    if out[ANISOTROPY] > ROUND and order > ONE_WAY:
        for k in range(3):
            out[TANGENT + k] = math.cos(angle) * frame[0, k] + math.sin(angle) * frame[1, k]
    n_s = (frame[2, 0], frame[2, 1], frame[2, 2])
    zeta = 2 * noise + 0.01 * top
    square, data = _specular_maps(room, n, g, rho[0], zeta, area, w, n_s[0], n_s[1], n_s[2], out)
    if settings.printed_maps:
        _printed_maps(room.specular, room, w, n_s, zeta, out, True)
    in_lobe = max(whole * whole / squares, 1.0)
    variance = (square / max(data, 1e-30) + 1e-6) * large * small / in_lobe + (1.0 if flag != GOOD else 0.0)
    return True, n_s, norm, passes, variance, square, data, flag
