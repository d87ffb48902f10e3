"""`shade` with exact Fresnel in one pass over the pixels, forward and backward (numba, float32, CPU).

The readable definition is `shading.plain`; tests hold this to it, gradients included.
"""

from __future__ import annotations

import numpy as np
from numba import get_num_threads, prange

from pipeline.kernels.compiling import kernel
from pipeline.optics.fresnel import HEMISPHERICAL, HEMISPHERICAL_RANGE, HEMISPHERICAL_STEP, MIN_EXCESS

from . import limits, splitsum
from .cube_kernels import MATH, add, direction_gradient, fetch, mirrored_texels, texels
from .prefilter_kernels import REFERENCE_IOR

_HEMISPHERICAL = np.array(HEMISPHERICAL, np.float32)
_HEMISPHERICAL_STEP = np.float32(HEMISPHERICAL_STEP)
_MIN_EXCESS, _MAX_EXCESS = np.float32(MIN_EXCESS), np.float32(HEMISPHERICAL_RANGE[1] - 1)
_LOW_IOR = np.float32(splitsum.IOR_RANGE[0])
_IOR_STEP = np.float32((splitsum.IOR_NODES - 1) / (splitsum.IOR_RANGE[1] - splitsum.IOR_RANGE[0]))
_IORS, _ROUGHS, _COSINES = splitsum.IOR_NODES, splitsum.ROUGHNESS_NODES, splitsum.COSINE_NODES
_ONE, _TWO, _HALF_ONE, _ZERO = np.float32(1), np.float32(2), np.float32(0.5), np.float32(0)
_MIN_COSINE, _MIN_IOR = np.float32(limits.MIN_COSINE), np.float32(limits.MIN_IOR)
_MIN_ROUGHNESS, _MAX_ROUGHNESS = np.float32(limits.MIN_ROUGHNESS), np.float32(limits.MAX_ROUGHNESS)

# Fewer pixels than this are not worth a thread's own table of gradients.
_CHUNK = 1024


def chunks(points: int) -> int:
    """Tables of gradients for `backward`: one a thread. The same on every run, so that sums repeat bit for bit."""
    return max(1, min(get_num_threads(), points // _CHUNK))


@kernel(fastmath=MATH, error_model="numpy")
def surface_point(normal, view, roughness, ior, p):
    """Point p: normal and view (tuples), cosine between them, and roughness and eta inside the limits."""
    n = (normal[p, 0], normal[p, 1], normal[p, 2])
    v = (view[p, 0], view[p, 1], view[p, 2])
    r = min(max(roughness[p], _MIN_ROUGHNESS), _MAX_ROUGHNESS)
    return n, v, n[0] * v[0] + n[1] * v[1] + n[2] * v[2], r, max(ior[p], _MIN_IOR)


@kernel(fastmath=MATH, error_model="numpy")
def _surface(c, e):
    """(T, dT/dc, dT/de, beta_d/sin^2, and its slopes): optics.fresnel's forms with derivatives."""
    q = np.sqrt((e - _ONE) * (e + _ONE) + c * c)
    qc, qe = c / q, e / q
    e2 = e * e
    ia, ib = _ONE / (c + q), _ONE / (e2 * c + q)
    w, p = _TWO * c * q, ia * ia + e2 * ib * ib
    wc, we = _TWO * (q + c * qc), _TWO * c * qe
    ia3, ib3 = ia * ia * ia, ib * ib * ib
    pc = -_TWO * (ia3 * (_ONE + qc) + e2 * ib3 * (e2 + qc))
    pe = -_TWO * ia3 * qe + _TWO * e * ib * ib - _TWO * e2 * ib3 * (_TWO * e * c + qe)
    a, b = e - _ONE / e, e + _ONE / e
    ae, be = _ONE + _ONE / e2, _ONE - _ONE / e2
    four = np.float32(4)
    den = _ONE / (b * b * c * c + a * b + four * c * q)
    body = a * a * den
    bc = -body * den * (_TWO * b * b * c + four * (q + c * qc))
    bE = _TWO * a * ae * den - body * den * (_TWO * b * be * c * c + ae * b + a * be + four * c * qe)
    return w * p, wc * p + w * pc, we * p + w * pe, body, bc, bE


@kernel(fastmath=MATH, error_model="numpy")
def _entering(e):
    """Hemispherical transmittance and its slope."""
    excess = min(max(e - _ONE, _ZERO), _MAX_EXCESS)
    root = np.sqrt(max(excess, _MIN_EXCESS))
    x = root * _HEMISPHERICAL_STEP - _ONE
    value, slope = _ZERO, _ZERO
    for k in range(len(_HEMISPHERICAL) - 1, -1, -1):
        slope = slope * x + value
        value = value * x + _HEMISPHERICAL[k]
    inside = e - _ONE <= _MAX_EXCESS
    return _ONE - excess * value, (-value - _HALF_ONE * root * _HEMISPHERICAL_STEP * slope if inside else _ZERO)


@kernel(fastmath=MATH, error_model="numpy")
def _cell(x, size):
    """Lower node and fraction of a grid coordinate, and whether it lies inside."""
    inside = x <= np.float32(size - 1)
    x = max(_ZERO, min(x, np.float32(size - 1)))
    i = min(max(int(x), 0), size - 2)
    return i, x - np.float32(i), _ONE if inside else _ZERO


@kernel(fastmath=MATH, error_model="numpy")
def _mirror(table, e, r, c, k):
    """Channel k of the split-sum table with its slopes in eta, r and cosine."""
    root = np.sqrt(c)
    h, z, inside = _cell((e - _LOW_IOR) * _IOR_STEP, _IORS)
    j, y, _ = _cell(r * np.float32(_ROUGHS - 1), _ROUGHS)
    i, x, _ = _cell(root * np.float32(_COSINES - 1), _COSINES)
    a0, a1 = table[h, j, i, k], table[h, j, i + 1, k]
    b0, b1 = table[h, j + 1, i, k], table[h, j + 1, i + 1, k]
    c0, c1 = table[h + 1, j, i, k], table[h + 1, j, i + 1, k]
    d0, d1 = table[h + 1, j + 1, i, k], table[h + 1, j + 1, i + 1, k]
    a, b, p, q = a0 + (a1 - a0) * x, b0 + (b1 - b0) * x, c0 + (c1 - c0) * x, d0 + (d1 - d0) * x
    near, far = a + (b - a) * y, p + (q - p) * y
    sx = ((a1 - a0) * (_ONE - y) + (b1 - b0) * y) * (_ONE - z) + ((c1 - c0) * (_ONE - y) + (d1 - d0) * y) * z
    sy = (b - a) * (_ONE - z) + (q - p) * z
    return (
        near + (far - near) * z,
        (far - near) * _IOR_STEP * inside,
        sy * np.float32(_ROUGHS - 1),
        sx * np.float32(_COSINES - 1) * _HALF_ONE / root,
    )


@kernel(fastmath=MATH, error_model="numpy")
def level_below(r, nodes):
    """Specular level below a roughness and the fraction towards the next."""
    k = 0
    while k < len(nodes) - 2 and r >= nodes[k + 1]:
        k += 1
    width = nodes[k + 1] - nodes[k]
    return k, (r - nodes[k]) / width, _ONE / width


@kernel(parallel=True, fastmath=MATH, error_model="numpy")
def forward(
    normal, view, albedo, roughness, ior, frame_x, frame_y, packed, nodes, sizes, starts, index, bases, table,
    shadow, bounced, unblocked, seen, given, turned, stokes, diffuse, specular,
):  # fmt: skip
    """Fill stokes [P, 3, 3], diffuse and specular [P, 3]; the last entry of sizes, starts and bases is the diffuse level.

    shadow [P, 3], bounced [P, 3]: received = shadow * irradiance + bounced; unblocked [P], seen [P, 3]: the same for
    the mirrored light. given [P, 3], turned [P, 2, 3]: mirrored light from `lobe` in place of the split sum's.
    Empty arrays: none of it.
    """
    last = len(sizes) - 1
    scale = _ONE / (np.float32(np.pi) * _entering(np.float32(REFERENCE_IOR))[0])
    for p in prange(len(normal)):
        n, v, facing, r, e = surface_point(normal, view, roughness, ior, p)
        n0, n1, n2 = n
        c = min(max(facing, _MIN_COSINE), _ONE)
        level, fraction, _ = level_below(r, nodes)
        lower, upper = mirrored_texels(n, facing, v, level, sizes, index, bases)
        around = texels(n0, n1, n2, sizes[last], index, bases[last])
        t, _, _, body, _, _ = _surface(c, e)
        leaving = t * _entering(e)[0] * scale
        rho = _mirror(table, e, r, c, 0)[0]
        across = _mirror(table, e, r, c, 1)[0]
        mirror = (_ONE - t) * rho
        nx = n0 * frame_x[p, 0] + n1 * frame_x[p, 1] + n2 * frame_x[p, 2]
        ny = n0 * frame_y[p, 0] + n1 * frame_y[p, 1] + n2 * frame_y[p, 2]
        cos2, sin2 = (nx - ny) * (nx + ny), _TWO * nx * ny
        for k in range(3):
            received = fetch(packed, starts[last], around, k)[0]
            below = fetch(packed, starts[level], lower, k)[0]
            above = fetch(packed, starts[level + 1], upper, k)[0]
            light = below + (above - below) * fraction
            if len(shadow) > 0:
                received = received * shadow[p, k] + bounced[p, k]
            if len(given) > 0:
                light = given[p, k]
                turn1, turn2 = turned[p, 0, k], turned[p, 1, k]
            else:
                turn1, turn2 = across * cos2 * light, across * sin2 * light
            if len(unblocked) > 0:
                open_, own = unblocked[p], seen[p, k]
                light = light * open_ + own
                turn1, turn2 = turn1 * open_ + across * cos2 * own, turn2 * open_ + across * sin2 * own
            d = leaving * albedo[p, k] * received
            s = mirror * light
            diffuse[p, k], specular[p, k] = d, s
            stokes[p, 0, k] = d + s
            stokes[p, 1, k] = cos2 * body * d - mirror * turn1
            stokes[p, 2, k] = sin2 * body * d - mirror * turn2


@kernel(parallel=True, fastmath=MATH, error_model="numpy")
def backward(
    normal, view, albedo, roughness, ior, frame_x, frame_y, packed, nodes, sizes, starts, index, bases, table,
    shadow, bounced, unblocked, seen, given, turned, g_stokes, g_diffuse, g_specular,
    g_normal, g_view, g_albedo, g_roughness, g_ior, g_packed, g_shadow, g_bounced, g_unblocked, g_seen,
    g_given, g_turned,
):  # fmt: skip
    """Gradients of `forward`; g_packed [chunks, T, 3] is one zeroed table per chunk of pixels, to be summed."""
    last = len(sizes) - 1
    count, chunks = len(normal), len(g_packed)
    scale = _ONE / (np.float32(np.pi) * _entering(np.float32(REFERENCE_IOR))[0])
    for chunk in prange(chunks):
        table_gradient = g_packed[chunk]
        for p in range(count * chunk // chunks, count * (chunk + 1) // chunks):
            n, v, facing, r, e = surface_point(normal, view, roughness, ior, p)
            n0, n1, n2 = n
            v0, v1, v2 = v
            c = min(max(facing, _MIN_COSINE), _ONE)
            two = _TWO * facing
            level, fraction, slope = level_below(r, nodes)
            lower, upper = mirrored_texels(n, facing, v, level, sizes, index, bases)
            around = texels(n0, n1, n2, sizes[last], index, bases[last])
            t, t_c, t_e, body, body_c, body_e = _surface(c, e)
            enter, enter_e = _entering(e)
            leaving = t * enter * scale
            rho, rho_e, rho_r, rho_c = _mirror(table, e, r, c, 0)
            across, across_e, across_r, across_c = _mirror(table, e, r, c, 1)
            reflect = _ONE - t
            mirror = reflect * rho
            nx = n0 * frame_x[p, 0] + n1 * frame_x[p, 1] + n2 * frame_x[p, 2]
            ny = n0 * frame_y[p, 0] + n1 * frame_y[p, 1] + n2 * frame_y[p, 2]
            cos2, sin2 = (nx - ny) * (nx + ny), _TWO * nx * ny

            g_cos2, g_sin2, g_body, g_across = _ZERO, _ZERO, _ZERO, _ZERO
            g_leaving, g_mirror, g_r, g_open = _ZERO, _ZERO, _ZERO, _ZERO
            gs_a, gt_a, gs_l, gt_l, gs_u, gt_u = _ZERO, _ZERO, _ZERO, _ZERO, _ZERO, _ZERO
            for k in range(3):
                irradiance, is_, it = fetch(packed, starts[last], around, k)
                below, bs, bt = fetch(packed, starts[level], lower, k)
                above, us, ut = fetch(packed, starts[level + 1], upper, k)
                mirrored = below + (above - below) * fraction
                received, own, open_ = irradiance, _ZERO, _ONE
                if len(shadow) > 0:
                    received = irradiance * shadow[p, k] + bounced[p, k]
                if len(unblocked) > 0:
                    open_, own = unblocked[p], seen[p, k]
                far1, far2 = across * cos2 * mirrored, across * sin2 * mirrored
                if len(given) > 0:
                    mirrored, far1, far2 = given[p, k], turned[p, 0, k], turned[p, 1, k]
                light = mirrored * open_ + own
                turn1, turn2 = far1 * open_ + across * cos2 * own, far2 * open_ + across * sin2 * own
                d = leaving * albedo[p, k] * received
                g0, g1, g2 = g_stokes[p, 0, k], g_stokes[p, 1, k], g_stokes[p, 2, k]
                gp = cos2 * g1 + sin2 * g2
                gd = g_diffuse[p, k] + g0 + body * gp
                gs = g_specular[p, k] + g0
                g_body += gp * d
                g_albedo[p, k] = gd * leaving * received
                g_leaving += gd * albedo[p, k] * received
                g_mirror += gs * light - g1 * turn1 - g2 * turn2
                gi, ge = gd * leaving * albedo[p, k], gs * mirror
                # Light polarised by the table: all of it, or the object's own alone where `lobe` gave the rest.
                by_table = light if len(given) == 0 else own
                g_across -= gp * mirror * by_table
                g_cos2 += g1 * (body * d - mirror * across * by_table)
                g_sin2 += g2 * (body * d - mirror * across * by_table)
                if len(shadow) > 0:
                    g_shadow[p, k], g_bounced[p, k] = gi * irradiance, gi
                    gi *= shadow[p, k]
                if len(given) > 0:
                    g_given[p, k] = ge * open_
                    g_turned[p, 0, k], g_turned[p, 1, k] = -g1 * mirror * open_, -g2 * mirror * open_
                    g_open += ge * mirrored - mirror * (g1 * far1 + g2 * far2)
                    if len(unblocked) > 0:
                        g_seen[p, k] = ge - gp * mirror * across
                    ge = _ZERO
                else:
                    ge -= gp * mirror * across
                    g_open += ge * mirrored
                    if len(unblocked) > 0:
                        g_seen[p, k] = ge
                    ge *= open_
                gs_a += gi * is_
                gt_a += gi * it
                g_r += ge * (above - below)
                gb, gu = ge * (_ONE - fraction), ge * fraction
                gs_l += gb * bs
                gt_l += gb * bt
                gs_u += gu * us
                gt_u += gu * ut
                add(table_gradient, starts[last], around, k, gi)
                add(table_gradient, starts[level], lower, k, gb)
                add(table_gradient, starts[level + 1], upper, k, gu)
            if len(unblocked) > 0:
                g_unblocked[p] = g_open

            g_c = (
                g_leaving * t_c * enter * scale + g_mirror * (reflect * rho_c - t_c * rho)
                + g_body * body_c + g_across * across_c
            )  # fmt: skip
            g_ior[p] = (
                g_leaving * scale * (t_e * enter + t * enter_e) + g_mirror * (reflect * rho_e - t_e * rho)
                + g_body * body_e + g_across * across_e
            )  # fmt: skip
            g_roughness[p] = g_r * slope + g_mirror * reflect * rho_r + g_across * across_r
            a0, a1, a2 = direction_gradient(around, sizes[last], gs_a, gt_a)
            l0, l1, l2 = direction_gradient(lower, sizes[level], gs_l, gt_l)
            u0, u1, u2 = direction_gradient(upper, sizes[level + 1], gs_u, gt_u)
            l0, l1, l2 = l0 + u0, l1 + u1, l2 + u2
            g_f = g_c + _TWO * (n0 * l0 + n1 * l1 + n2 * l2)
            g_x, g_y = _TWO * (g_cos2 * nx + g_sin2 * ny), _TWO * (g_sin2 * nx - g_cos2 * ny)
            g_normal[p, 0] = a0 + two * l0 + g_f * v0 + g_x * frame_x[p, 0] + g_y * frame_y[p, 0]
            g_normal[p, 1] = a1 + two * l1 + g_f * v1 + g_x * frame_x[p, 1] + g_y * frame_y[p, 1]
            g_normal[p, 2] = a2 + two * l2 + g_f * v2 + g_x * frame_x[p, 2] + g_y * frame_y[p, 2]
            g_view[p, 0], g_view[p, 1], g_view[p, 2] = g_f * n0 - l0, g_f * n1 - l1, g_f * n2 - l2
