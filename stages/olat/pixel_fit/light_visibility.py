"""Which lights reach a pixel, how much of their light is lost on the way, and what arrives from behind the surface."""

from __future__ import annotations

import math

from pipeline.kernels.compiling import kernel
from pipeline.kernels.numerics import FAST, HALF, ONE, TWO, ZERO
from stages.olat.pixel_fit.result_layout import INTER_D, INTER_S, OCCLUSION_D, OCCLUSION_S, VISIBILITY_D, VISIBILITY_S


@kernel(fastmath=FAST, error_model="numpy")
def behind(light, ok, wx, wy, wz, nx, ny, nz):
    """Root mean square of the samples whose light is behind the surface: noise and inter-reflection."""
    s = n = ZERO * nx
    for k in range(light.size):
        p = nx * wx[k] + ny * wy[k] + nz * wz[k]
        w, v = ok[k], light[k]
        w = w if p < -HALF * HALF else ZERO
        s += w * v * v
        n += w
    return math.sqrt(s / n) if n > ZERO else ZERO


@kernel(fastmath=FAST, error_model="numpy")
def _seen(diffuse, ok, wx, wy, wz, nx, ny, nz, albedo, zeta, use):
    """`use` [N]: 1 for a light before the surface that is seen, else 0."""
    for k in range(use.size):
        p = nx * wx[k] + ny * wy[k] + nz * wz[k]
        v, q, usable = diffuse[k], albedo * p, ok[k]
        arrives = (v > HALF * q) | (q < TWO * zeta) | (usable == ZERO)  # clipped: surely lit; not finite: counted as lit
        use[k] = ONE if (p > ZERO) & arrives else ZERO


@kernel(fastmath=FAST, error_model="numpy")
def _diffuse_sums(diffuse, rgb, ok, wx, wy, wz, area, nx, ny, nz, albedo, zeta, use):
    """Sums over the lights of one pixel, of which those in `use` are seen. It stores nothing: then it vectorises."""
    seen = front = lit = whole = square = data = r = g = b = ZERO * nx
    for k in range(area.size):
        p = nx * wx[k] + ny * wy[k] + nz * wz[k]
        v, u, a, usable = diffuse[k], use[k], area[k], ok[k]
        before = p > ZERO
        miss = v - albedo * p
        seen += u
        lit += u * p * a
        front += ONE if before else ZERO
        whole += p * a if before else ZERO
        u *= usable
        square += u * miss * miss
        data += u * v * v
        e = -p * a if (not before) & (usable > ZERO) & (v > zeta) else ZERO
        r += e * rgb[0, k]
        g += e * rgb[1, k]
        b += e * rgb[2, k]
    return seen, front, lit, whole, square, data, r, g, b


@kernel(error_model="numpy")
def diffuse_maps(workspace, w, area, n_d, albedo, zeta, out):
    """Visibility, occlusion (Eq. 5, normalised by the rig's own unoccluded sum), inter-reflection (Eq. 4); residual sums."""
    kind = area.dtype.type
    nx, ny, nz, size, floor = kind(n_d[0]), kind(n_d[1]), kind(n_d[2]), kind(albedo), kind(zeta)
    _seen(workspace.diffuse, workspace.ok, w[0], w[1], w[2], nx, ny, nz, size, floor, workspace.use)
    seen, front, lit, whole, square, data, r, g, b = _diffuse_sums(
        workspace.diffuse, workspace.rgb, workspace.ok, w[0], w[1], w[2], area, nx, ny, nz, size, floor, workspace.use
    )
    out[VISIBILITY_D] = seen / front if front > 0 else 0.0
    out[OCCLUSION_D] = lit / whole if whole > 0 else 0.0
    out[INTER_D], out[INTER_D + 1], out[INTER_D + 2] = max(r, 0.0) / math.pi, max(g, 0.0) / math.pi, max(b, 0.0) / math.pi
    return float(square), float(data)


@kernel(fastmath=FAST, error_model="numpy")
def _lobe_sums(light, g, area, seen, bound, rho, zeta):
    """Sums over the lights before the surface: expected, arriving, energies and the residual's squares."""
    expected = arriving = lit = whole = square = data = ZERO * rho
    for k in range(light.size):
        p, v = rho * g[k], light[k]
        arrives = (v > HALF * p) | (p < TWO * zeta)
        e = p * area[k]
        whole += e
        lit += e if arrives else ZERO
        bright = p > TWO * zeta
        expected += ONE if bright else ZERO
        arriving += ONE if bright & arrives else ZERO
        u, b = seen[k], bound[k]
        u = ZERO if (u == ZERO) | ((b > ZERO) & (p > v)) else ONE
        square += u * (v - p) * (v - p)
        data += u * v * v
    return expected, arriving, lit, whole, square, data


@kernel(fastmath=FAST, error_model="numpy")
def _from_behind(light, ok, wx, wy, wz, area, nx, ny, nz, zeta):
    """Light that arrives from behind the surface, weighted by the cosine."""
    s = ZERO * nx
    for k in range(light.size):
        p = nx * wx[k] + ny * wy[k] + nz * wz[k]
        v, e, usable = light[k], p * area[k], ok[k]
        s -= e * v if (p < ZERO) & (usable > ZERO) & (v > zeta) else ZERO
    return s


@kernel(error_model="numpy")
def specular_maps(workspace, n, g, rho, found, zeta, all_area, w, n_s, out):
    """Share of the lobe's lights and energy that arrives, and what arrives from behind; returns residual sums.

    The residual is that of the albedo `found` by the fit: a bounded one, `rho`, would not tell how well the lobe's form fits.
    """
    kind = all_area.dtype.type
    light, area, seen, bound = workspace.light[:n], workspace.area[:n], workspace.seen[:n], workspace.bound[:n]
    expected, arriving, lit, whole, square, data = _lobe_sums(light, g, area, seen, bound, kind(rho), kind(zeta))
    if rho < found:
        _, _, _, _, square, data = _lobe_sums(light, g, area, seen, bound, kind(found), kind(zeta))
    out[VISIBILITY_S] = arriving / expected if expected > 0 else 0.0
    out[OCCLUSION_S] = lit / whole if whole > 0 else 0.0
    x, y, z = kind(n_s[0]), kind(n_s[1]), kind(n_s[2])
    out[INTER_S] = max(_from_behind(workspace.specular, workspace.ok, w[0], w[1], w[2], all_area, x, y, z, kind(zeta)), 0.0)
    return float(square), float(data)


@kernel(error_model="numpy")
def printed_maps(light, workspace, w, n, zeta, out, specular):
    """PRF Eqs. 4 and 5 as printed: every light counts alike, 4/N normalises, `I > zeta` is visible."""
    lit = seen = front = r = g = b = 0.0
    for k in range(light.size):
        p = n[0] * w[0, k] + n[1] * w[1, k] + n[2] * w[2, k]
        arrives = light[k] > zeta and workspace.ok[k] > 0
        if p > 0:
            front += 1
            if arrives:
                seen += 1
                lit += p
        elif arrives:
            r -= p * (light[k] if specular else workspace.rgb[0, k])
            g -= p * workspace.rgb[1, k]
            b -= p * workspace.rgb[2, k]
    visible = seen / front if front > 0 else 0.0
    if specular:
        out[OCCLUSION_S], out[VISIBILITY_S], out[INTER_S] = 4 * lit / light.size, visible, max(r, 0.0)
    else:
        out[OCCLUSION_D], out[VISIBILITY_D] = 4 * lit / light.size, visible
        out[INTER_D], out[INTER_D + 1], out[INTER_D + 2] = max(r, 0.0), max(g, 0.0), max(b, 0.0)
