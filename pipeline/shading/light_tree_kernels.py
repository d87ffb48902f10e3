"""`light_tree` over the pixels of a view, forward and backward: numba, float32. Its readable twin: `light_tree.plain`."""

from __future__ import annotations

import numpy as np
from numba import prange

from pipeline.kernels.compiling import kernel

from . import limits
from .cube import AXES
from .shade_kernels import MATH

_AXES = AXES.astype(np.float32)
_ZERO, _HALF, _ONE, _TWO, _FOUR = (np.float32(x) for x in (0, 0.5, 1, 2, 4))
_MIN_IOR = np.float32(limits.MIN_IOR)
_MIN_ROUGHNESS, _MAX_ROUGHNESS = np.float32(limits.MIN_ROUGHNESS), np.float32(limits.MAX_ROUGHNESS)
_TINY = np.float32(1e-6)
_BRIGHT = np.float32(limits.BRIGHT)
_AWAY = np.float32(limits.AWAY)
_NOTHING = np.float32(limits.NOTHING)
_LEAST = np.float32(1e-4)  # cosine of the light below which its shadowing is taken as there: the slope of 1/cosine^2 is finite
_END = np.float32(limits.BECKMANN_END)
CAPACITY = 8192  # nodes a pixel may take, far more than the narrowest lobe takes; beyond it they are taken whole
_STACK = 64  # three waiting siblings a level at most, of 8 levels of cubes and 8 of cells, and the next four


@kernel(fastmath=MATH, error_model="numpy")
def _lobe(n, v, l, nv, a2, e, ggx, variance):
    """(weight D G1(l) F, h, v.h, n.h, n.l, sin^2, D's width) of light from l; weight 0 below the horizon.

    The light's own spread about l widens the lobe: variances of slopes add.
    """
    s0, s1, s2 = v[0] + l[0], v[1] + l[1], v[2] + l[2]
    nl = n[0] * l[0] + n[1] * l[1] + n[2] * l[2]
    square = max(s0 * s0 + s1 * s1 + s2 * s2, _TINY)
    inverse = _ONE / np.sqrt(square)
    h0, h1, h2 = s0 * inverse, s1 * inverse, s2 * inverse
    vh = _HALF * square * inverse
    nh = (nv + nl) * inverse
    c0, c1, c2 = n[1] * h2 - n[2] * h1, n[2] * h0 - n[0] * h2, n[0] * h1 - n[1] * h0
    sin2 = c0 * c0 + c1 * c1 + c2 * c2
    if nl <= _ZERO or nh <= _TINY:
        return _ZERO, h0, h1, h2, vh, nh, nl, sin2, a2
    slopes = variance * (_ONE + _ONE / (vh * vh)) * np.float32(0.125)
    cos2 = nh * nh
    if ggx:
        wide = a2
        inverse = _ONE / (a2 * cos2 + sin2)
        d = a2 * inverse * inverse
        d *= max(_ONE + slopes * cos2 * (np.float32(8) * sin2 - _FOUR * a2 * cos2) * inverse * inverse, _HALF)
    else:
        wide = a2 + _TWO * slopes
        d = np.exp(-sin2 / (cos2 * wide)) / (wide * cos2 * cos2)
    level = max(nl, _LEAST)
    t2 = (_ONE - level) * (_ONE + level) / (level * level)
    if ggx:
        g = _TWO / (_ONE + np.sqrt(_ONE + a2 * t2))
    else:
        a = _ONE / np.sqrt(max(a2 * t2, np.float32(1e-12)))
        g = _ONE
        if a < np.float32(1.6):
            top = _ONE - np.float32(1.259) * a + np.float32(0.396) * a * a
            g = _ONE / (_ONE + top / (np.float32(3.535) * a + np.float32(2.181) * a * a))
    k2 = (e - _ONE) * (e + _ONE)
    root = np.sqrt(k2 + vh * vh)
    x = k2 / ((vh + root) * (vh + root))
    e2 = e * e
    y = k2 * ((e2 + _ONE) * vh * vh - _ONE) / ((e2 * vh + root) * (e2 * vh + root))
    return d * g * (x * x + y * y), h0, h1, h2, vh, nh, nl, sin2, wide


@kernel(fastmath=MATH, error_model="numpy")
def _cell(node, depth, a, b, size):
    """Cell (a, b) of the 2^depth x 2^depth that a texel's tent is cut into: direction, solid angle times height, variance."""
    face = node // (size * size)
    j, i = (node // size) % size, node % size
    step = _TWO / np.float32(1 << depth)
    x, y = (np.float32(a) + _HALF) * step - _ONE, (np.float32(b) + _HALF) * step - _ONE
    p, q = _ONE - abs(x), _ONE - abs(y)
    # The tent leans towards its top: so does the centre of a cell's light, and its variance is less than a box's.
    lean, rise = step * step / (np.float32(12) * p), step * step / (np.float32(12) * q)
    half = _TWO / np.float32(size)
    variance = half * half * _HALF * (step * step * np.float32(1 / 6) - lean * lean - rise * rise)
    x, y = x - (lean if x > _ZERO else -lean), y - (rise if y > _ZERO else -rise)
    u, w = (np.float32(i) + _HALF + x) * half - _ONE, (np.float32(j) + _HALF + y) * half - _ONE
    n, s, t = _AXES[face, 0], _AXES[face, 1], _AXES[face, 2]
    d0 = n[0] + u * s[0] + w * t[0]
    d1 = n[1] + u * s[1] + w * t[1]
    d2 = n[2] + u * s[2] + w * t[2]
    inverse = _ONE / np.sqrt(d0 * d0 + d1 * d1 + d2 * d2)
    shrink = inverse * inverse * inverse
    angle = half * half * step * step * shrink * p * q
    return d0 * inverse, d1 * inverse, d2 * inverse, angle, variance * shrink


@kernel(fastmath=MATH, error_model="numpy")
def _choose(n, v, nv, a2, ggx, place, angle, radius, child, first_root, size, tolerance, most, stack, nodes, leaves):
    """Fill nodes [M] and leaves [M, 5] (direction, solid angle, variance) with what the lobe is summed over; returns how many.

    stack [_STACK, 4]: node, depth of the cell in a texel's tent (0: the node itself), and which cell.
    """
    count, limit = 0, len(nodes) - _STACK
    steep = _ONE / np.sqrt(a2)
    end, bend = a2 * _END, tolerance * np.float32(0.25)
    for root in range(first_root, len(child)):
        top = 1
        stack[0, 0], stack[0, 1] = root, 0
        while top > 0:
            top -= 1
            node, depth, a, b = stack[top, 0], stack[top, 1], stack[top, 2], stack[top, 3]
            texel = child[node, 0] < 0
            if depth == 0:
                l0, l1, l2, omega, variance = place[node, 0], place[node, 1], place[node, 2], angle[node], place[node, 3]
                wide = radius[node] * np.float32(1.4142135) if texel else radius[node]  # a texel's tent is wider than it
            else:
                l0, l1, l2, omega, variance = _cell(node, depth, a, b, size)
                wide = radius[node] * _TWO / np.float32(1 << depth)
            nl = n[0] * l0 + n[1] * l1 + n[2] * l2
            if nl < -_TWO * wide:
                continue
            square = max(_TWO + _TWO * (v[0] * l0 + v[1] * l1 + v[2] * l2), _TINY)
            turn = wide / np.sqrt(square)  # of the half vector, at most
            near = max(np.sqrt(max(_ONE - (nv + nl) * (nv + nl) / square, _ZERO)) - turn, _ZERO)
            near *= near
            allowed = tolerance * (a2 * (_ONE - near) + near) * steep
            if not ggx and near > end * (_ONE - near):
                continue
            # Within the lobe, bright nodes that the horizon crosses are cut, and texels over which Fresnel's term bends.
            cut = depth < 2 and near * steep * steep < _FOUR and place[node, 4] > _BRIGHT
            cut = cut and (abs(nl) < wide or (texel and turn > bend))
            if (turn <= allowed and not cut) or (texel and depth >= most) or count >= limit:
                if nl > _ZERO:
                    nodes[count] = node
                    leaves[count, 0], leaves[count, 1], leaves[count, 2] = l0, l1, l2
                    leaves[count, 3], leaves[count, 4] = omega, variance
                    count += 1
            elif not texel:
                for k in range(4):
                    stack[top, 0], stack[top, 1] = child[node, k], 0
                    top += 1
            else:
                for k in range(4):
                    stack[top, 0], stack[top, 1] = node, depth + 1
                    stack[top, 2], stack[top, 3] = 2 * a * (depth > 0) + (k & 1), 2 * b * (depth > 0) + (k >> 1)
                    top += 1
    return count


@kernel(fastmath=MATH, error_model="numpy")
def _polarisation(c, square, e):
    """beta_s/sin^2 with its slopes in c, square = sin^2, and eta."""
    q = np.sqrt((e - _ONE) * (e + _ONE) + c * c)
    x = c * q
    d = _ONE / (x * x + square * square)
    value = _TWO * x * d
    by_x = _TWO * d - value * _TWO * x * d
    return value, by_x * (q + c * c / q), -value * _TWO * square * d, by_x * c * e / q


@kernel(parallel=True, fastmath=MATH, error_model="numpy")
def forward(
    normal, view, roughness, ior, frame_x, frame_y, radiance, place, angle, radius, child, first_root, size,
    tolerance, most, ggx, value, turned, total,
):  # fmt: skip
    """Fill value [P, 3], turned [P, 2, 3] and total [P], the sum of weights that both were divided by."""
    tolerance = np.float32(tolerance)
    parts = max(1, len(normal) // 128)
    for part in prange(parts):
        stack, nodes = np.empty((_STACK, 4), np.int32), np.empty(CAPACITY, np.int32)
        leaves = np.empty((CAPACITY, 5), np.float32)
        for p in range(len(normal) * part // parts, len(normal) * (part + 1) // parts):
            n = (normal[p, 0], normal[p, 1], normal[p, 2])
            v = (view[p, 0], view[p, 1], view[p, 2])
            x, y = frame_x[p], frame_y[p]
            r = min(max(roughness[p], _MIN_ROUGHNESS), _MAX_ROUGHNESS)
            a2 = r * r * r * r
            e = max(ior[p], _MIN_IOR)
            nv = n[0] * v[0] + n[1] * v[1] + n[2] * v[2]
            count = 0
            if nv > _AWAY:
                count = _choose(
                    n, v, nv, a2, ggx, place, angle, radius, child, first_root, size, tolerance, most, stack, nodes, leaves
                )  # fmt: skip
            s0, s1, s2, sum_ = _ZERO, _ZERO, _ZERO, _ZERO
            t0, t1, t2, u0, u1, u2 = _ZERO, _ZERO, _ZERO, _ZERO, _ZERO, _ZERO
            for k in range(count):
                l = (leaves[k, 0], leaves[k, 1], leaves[k, 2])
                w, h0, h1, h2, vh, _, _, _, _ = _lobe(n, v, l, nv, a2, e, ggx, leaves[k, 4])
                w *= leaves[k, 3]
                hx = h0 * x[0] + h1 * x[1] + h2 * x[2]
                hy = h0 * y[0] + h1 * y[1] + h2 * y[2]
                beta = w * _polarisation(vh, hx * hx + hy * hy, e)[0]
                cos2, sin2 = (hx - hy) * (hx + hy) * beta, _TWO * hx * hy * beta
                c0, c1, c2 = radiance[nodes[k], 0], radiance[nodes[k], 1], radiance[nodes[k], 2]
                sum_ += w
                s0, s1, s2 = s0 + w * c0, s1 + w * c1, s2 + w * c2
                t0, t1, t2 = t0 + cos2 * c0, t1 + cos2 * c1, t2 + cos2 * c2
                u0, u1, u2 = u0 + sin2 * c0, u1 + sin2 * c1, u2 + sin2 * c2
            sum_ = sum_ if sum_ > _NOTHING else _ZERO
            total[p] = sum_
            inverse = _ONE / sum_ if sum_ > _ZERO else _ZERO
            value[p, 0], value[p, 1], value[p, 2] = s0 * inverse, s1 * inverse, s2 * inverse
            turned[p, 0, 0], turned[p, 0, 1], turned[p, 0, 2] = t0 * inverse, t1 * inverse, t2 * inverse
            turned[p, 1, 0], turned[p, 1, 1], turned[p, 1, 2] = u0 * inverse, u1 * inverse, u2 * inverse


@kernel(fastmath=MATH, error_model="numpy")
def _slopes(nh, nl, vh, sin2, a2, e, ggx, variance):
    """Slopes of log(D G1 F) in n.h, n.l, v.h, alpha^2 and eta, with the spread of the light as in `_lobe`."""
    cos2 = nh * nh
    stretch = _ONE + _ONE / (vh * vh)
    slopes = variance * stretch * np.float32(0.125)
    by_spread = _ZERO
    if ggx:
        inverse = _ONE / (a2 * cos2 + sin2)
        by_nh = _FOUR * nh * (_ONE - a2) * inverse
        by_a2 = _ONE / a2 - _TWO * cos2 * inverse
        square = inverse * inverse
        lift = np.float32(8) * sin2 - _FOUR * a2 * cos2
        wider = _ONE + slopes * cos2 * lift * square
        if wider > _HALF:
            part = slopes / wider
            by_cos2 = lift * square - cos2 * (np.float32(8) + _FOUR * a2) * square
            by_cos2 -= _TWO * cos2 * lift * (a2 - _ONE) * square * inverse
            by_nh += part * by_cos2 * _TWO * nh
            by_a2 -= part * cos2 * cos2 * (_FOUR * square + _TWO * lift * square * inverse)
            by_spread = cos2 * lift * square / wider
    else:
        wide = a2 + _TWO * slopes
        tan2 = sin2 / cos2
        by_nh = _TWO / (cos2 * nh * wide) - _FOUR / nh
        by_a2 = (tan2 / wide - _ONE) / wide
        by_spread = _TWO * by_a2
    by_vh = -by_spread * variance * np.float32(0.25) / (vh * vh * vh)
    level = max(nl, _LEAST)
    t2 = (_ONE - level) * (_ONE + level) / (level * level)
    by_t2 = _ZERO
    if ggx:
        root = np.sqrt(_ONE + a2 * t2)
        share = -_HALF / (root * (_ONE + root))
        by_t2, by_a2 = share * a2, by_a2 + share * t2
    else:
        a = _ONE / np.sqrt(max(a2 * t2, np.float32(1e-12)))
        if a < np.float32(1.6):
            top = _ONE - np.float32(1.259) * a + np.float32(0.396) * a * a
            low = _ONE / (np.float32(3.535) * a + np.float32(2.181) * a * a)
            lam = top * low
            slope = (np.float32(0.792) * a - np.float32(1.259)) * low
            slope -= lam * (np.float32(3.535) + np.float32(4.362) * a) * low
            by_log = _HALF * a * slope / (_ONE + lam)  # d log G / d log of alpha^2 and of tan^2
            by_a2 += by_log / a2
            by_t2 = by_log / max(t2, np.float32(1e-12))
    by_nl = -_TWO * by_t2 / (level * level * level) if nl > _LEAST else _ZERO
    k2 = (e - _ONE) * (e + _ONE)
    root = np.sqrt(k2 + vh * vh)
    e2 = e * e
    i, j = _ONE / (vh + root), _ONE / (e2 * vh + root)
    x = k2 * i * i
    face = (e2 + _ONE) * vh * vh - _ONE
    y = k2 * face * j * j
    share = _TWO / max(x * x + y * y, np.float32(1e-30))
    x_c, x_e = -_TWO * x / root, _TWO * e * i * i - _TWO * x * i * e / root
    y_c = k2 * _TWO * (e2 + _ONE) * vh * j * j - _TWO * y * j * (e2 + vh / root)
    y_e = _TWO * e * face * j * j + k2 * _TWO * e * vh * vh * j * j - _TWO * y * j * (_TWO * e * vh + e / root)
    return by_nh, by_nl, by_vh + share * (x * x_c + y * y_c), by_a2, share * (x * x_e + y * y_e)


@kernel(fastmath=MATH, error_model="numpy")
def _hidden_gradient(n, v, nv, g, size, table):
    """A point that sees nothing of its lobe mirrors the texel straight ahead."""
    d0, d1, d2 = _TWO * nv * n[0] - v[0], _TWO * nv * n[1] - v[1], _TWO * nv * n[2] - v[2]
    x, y, z = abs(d0), abs(d1), abs(d2)
    if x >= y and x >= z:
        face, major = (1 if d0 < 0 else 0), x
    elif y >= z:
        face, major = (3 if d1 < 0 else 2), y
    else:
        face, major = (5 if d2 < 0 else 4), z
    s, t = _AXES[face, 1], _AXES[face, 2]
    inverse = _ONE / max(major, _TINY)
    half = _HALF * np.float32(size)
    i = int((_ONE + (d0 * s[0] + d1 * s[1] + d2 * s[2]) * inverse) * half)
    j = int((_ONE + (d0 * t[0] + d1 * t[1] + d2 * t[2]) * inverse) * half)
    node = (face * size + min(max(j, 0), size - 1)) * size + min(max(i, 0), size - 1)
    for k in range(3):
        table[node, k] += g[k]


@kernel(parallel=True, fastmath=MATH, error_model="numpy")
def backward(
    normal, view, roughness, ior, frame_x, frame_y, radiance, place, angle, radius, child, first_root, size,
    tolerance, most, ggx, value, turned, total, g_value, g_turned, g_normal, g_view, g_roughness, g_ior, g_radiance,
):  # fmt: skip
    """Gradients of `forward`; g_radiance [chunks, S, 3] is one zeroed table per chunk of pixels, to be summed."""
    tolerance = np.float32(tolerance)
    points, parts = len(normal), len(g_radiance)
    for part in prange(parts):
        stack, nodes = np.empty((_STACK, 4), np.int32), np.empty(CAPACITY, np.int32)
        leaves = np.empty((CAPACITY, 5), np.float32)
        table = g_radiance[part]
        for p in range(points * part // parts, points * (part + 1) // parts):
            n = (normal[p, 0], normal[p, 1], normal[p, 2])
            v = (view[p, 0], view[p, 1], view[p, 2])
            x, y = frame_x[p], frame_y[p]
            r = min(max(roughness[p], _MIN_ROUGHNESS), _MAX_ROUGHNESS)
            a2 = r * r * r * r
            e = max(ior[p], _MIN_IOR)
            nv = n[0] * v[0] + n[1] * v[1] + n[2] * v[2]
            gn0, gn1, gn2, gv0, gv1, gv2, ga, ge = _ZERO, _ZERO, _ZERO, _ZERO, _ZERO, _ZERO, _ZERO, _ZERO
            count = 0
            if total[p] > _ZERO:
                count = _choose(
                    n, v, nv, a2, ggx, place, angle, radius, child, first_root, size, tolerance, most, stack, nodes, leaves
                )  # fmt: skip
            inverse = _ONE / max(total[p], np.float32(1e-30))
            a0, a1, a2_ = g_value[p, 0], g_value[p, 1], g_value[p, 2]
            b0, b1, b2 = g_turned[p, 0, 0], g_turned[p, 0, 1], g_turned[p, 0, 2]
            c0, c1, c2 = g_turned[p, 1, 0], g_turned[p, 1, 1], g_turned[p, 1, 2]
            mean = a0 * value[p, 0] + a1 * value[p, 1] + a2_ * value[p, 2]
            mean += b0 * turned[p, 0, 0] + b1 * turned[p, 0, 1] + b2 * turned[p, 0, 2]
            mean += c0 * turned[p, 1, 0] + c1 * turned[p, 1, 1] + c2 * turned[p, 1, 2]
            for k in range(count):
                l = (leaves[k, 0], leaves[k, 1], leaves[k, 2])
                w, h0, h1, h2, vh, nh, nl, sin2, _ = _lobe(n, v, l, nv, a2, e, ggx, leaves[k, 4])
                w *= leaves[k, 3] * inverse
                if w <= _ZERO:
                    continue
                hx = h0 * x[0] + h1 * x[1] + h2 * x[2]
                hy = h0 * y[0] + h1 * y[1] + h2 * y[2]
                beta, beta_c, beta_s, beta_e = _polarisation(vh, hx * hx + hy * hy, e)
                cos2, sin2_ = (hx - hy) * (hx + hy), _TWO * hx * hy
                node = nodes[k]
                r0, r1, r2 = radiance[node, 0], radiance[node, 1], radiance[node, 2]
                table[node, 0] += w * (a0 + beta * (cos2 * b0 + sin2_ * c0))
                table[node, 1] += w * (a1 + beta * (cos2 * b1 + sin2_ * c1))
                table[node, 2] += w * (a2_ + beta * (cos2 * b2 + sin2_ * c2))
                along1, along2 = b0 * r0 + b1 * r1 + b2 * r2, c0 * r0 + c1 * r1 + c2 * r2
                g_beta = w * (cos2 * along1 + sin2_ * along2)
                g_w = w * (a0 * r0 + a1 * r1 + a2_ * r2 - mean) + beta * g_beta
                by_nh, by_nl, by_vh, by_a2, by_e = _slopes(nh, nl, vh, sin2, a2, e, ggx, leaves[k, 4])
                ga += g_w * by_a2
                ge += g_w * by_e + g_beta * beta_e
                g_square = g_beta * beta_s
                g_x = _TWO * (w * beta * (along1 * hx + along2 * hy) + g_square * hx)
                g_y = _TWO * (w * beta * (along2 * hx - along1 * hy) + g_square * hy)
                g_nh, g_nl = g_w * by_nh, g_w * by_nl
                g_vh = _HALF * (g_w * by_vh + g_beta * beta_c)
                gn0 += g_nh * h0 + g_nl * l[0]
                gn1 += g_nh * h1 + g_nl * l[1]
                gn2 += g_nh * h2 + g_nl * l[2]
                gh0 = g_nh * n[0] + g_x * x[0] + g_y * y[0]
                gh1 = g_nh * n[1] + g_x * x[1] + g_y * y[1]
                gh2 = g_nh * n[2] + g_x * x[2] + g_y * y[2]
                shorter = _HALF / vh
                lost = g_vh - (gh0 * h0 + gh1 * h1 + gh2 * h2) * shorter
                gv0 += gh0 * shorter + lost * h0
                gv1 += gh1 * shorter + lost * h1
                gv2 += gh2 * shorter + lost * h2
            if not total[p] > _ZERO:
                _hidden_gradient(n, v, nv, g_value[p], size, table)
            g_normal[p, 0], g_normal[p, 1], g_normal[p, 2] = gn0, gn1, gn2
            g_view[p, 0], g_view[p, 1], g_view[p, 2] = gv0, gv1, gv2
            g_roughness[p], g_ior[p] = ga * _FOUR * r * r * r, ge
