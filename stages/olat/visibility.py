"""Which lights reach a pixel, how much of their light is lost on the way, and what arrives from behind the surface."""

from __future__ import annotations

import math

from numba import njit

from pipeline.lights.numerics import FAST, HALF, ONE, ZERO
from stages.olat.columns import INTER_D, INTER_S, OCCLUSION_D, OCCLUSION_S, VISIBILITY_D, VISIBILITY_S


@njit(cache=True, fastmath=FAST, error_model="numpy")
def behind(light, ok, wx, wy, wz, nx, ny, nz):
    """Root mean square of the samples whose light is behind the surface: noise and inter-reflection."""
    s = n = ZERO * nx
    for k in range(light.size):
        p = nx * wx[k] + ny * wy[k] + nz * wz[k]
        w = ok[k] if p < -HALF * HALF else ZERO
        s += w * light[k] * light[k]
        n += w
    return math.sqrt(s / n) if n > ZERO else ZERO


@njit(cache=True, error_model="numpy")
def diffuse_maps(room, w, area, nx, ny, nz, albedo, zeta, out):
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
def specular_maps(room, n, g, rho, zeta, all_area, w, nx, ny, nz, out):
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
def printed_maps(light, room, w, n, zeta, out, specular):
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
