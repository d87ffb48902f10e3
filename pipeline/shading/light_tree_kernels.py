"""`light_tree` over the pixels of a view, forward and backward: numba, float32. Its readable twin: `light_tree_plain.plain`."""

from __future__ import annotations

import numpy as np
from numba import prange

from pipeline.kernels.compiling import kernel

from . import limits
from .cube import AXES
from .cube_kernels import MATH
from .facet_kernels import polarisation
from .light_tree_lobe import leaf_gradient, lobe_weight
from .shade_kernels import surface_point

_AXES = AXES.astype(np.float32)
_ZERO, _HALF, _ONE, _TWO, _FOUR = (np.float32(x) for x in (0, 0.5, 1, 2, 4))
_TINY = np.float32(1e-6)
_BRIGHT = np.float32(limits.BRIGHT)
_AWAY = np.float32(limits.AWAY)
_NOTHING = np.float32(limits.NOTHING)
_END = np.float32(limits.BECKMANN_END)
# Leaves that a pixel may take; beyond it nodes are taken whole. Grazing views of narrow lobes take the most: 18 000 under
# "tree-fine" and a cube of 256.
CAPACITY = 65536
_STACK = 64  # three waiting siblings a level at most, of 8 levels of cubes and 8 of cells, and the next four


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
def choose(n, v, nv, a2, ggx, place, angle, radius, child, first_root, size, tolerance, most, stack, nodes, leaves):
    """Fill nodes [M] and leaves [M, 5] (direction, solid angle, variance) with what the lobe is summed over; returns how many.

    stack [_STACK, 4]: node, depth of the cell in a texel's tent (0: the node itself), and which cell.
    """
    # Whatever waits when the limit is reached, on the stack and of the roots, may still add one leaf each.
    count, limit = 0, len(nodes) - _STACK - (len(child) - first_root)
    steep = _ONE / np.sqrt(a2)
    end, bend = a2 * _END, tolerance * np.float32(0.25)
    for root in range(first_root, len(child)):
        top, stack[0, 0], stack[0, 1] = 1, root, 0
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
            n, v, nv, r, e = surface_point(normal, view, roughness, ior, p)
            x, y, a2 = frame_x[p], frame_y[p], r * r * r * r
            count = 0
            if nv > _AWAY:
                count = choose(
                    n, v, nv, a2, ggx, place, angle, radius, child, first_root, size, tolerance, most, stack, nodes, leaves
                )  # fmt: skip
            s0, s1, s2, sum_ = _ZERO, _ZERO, _ZERO, _ZERO
            t0, t1, t2, u0, u1, u2 = _ZERO, _ZERO, _ZERO, _ZERO, _ZERO, _ZERO
            for k in range(count):
                l = (leaves[k, 0], leaves[k, 1], leaves[k, 2])
                w, h0, h1, h2, vh, _, _, _, _ = lobe_weight(n, v, l, nv, a2, e, ggx, leaves[k, 4])
                w *= leaves[k, 3]
                hx = h0 * x[0] + h1 * x[1] + h2 * x[2]
                hy = h0 * y[0] + h1 * y[1] + h2 * y[2]
                beta = w * polarisation(vh, hx * hx + hy * hy, e)[0]
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


@kernel(parallel=True, fastmath=MATH, error_model="numpy")
def backward(
    normal, view, roughness, ior, frame_x, frame_y, radiance, place, angle, radius, child, first_root, size,
    tolerance, most, ggx, value, turned, total, g_value, g_turned, g_normal, g_view, g_roughness, g_ior, g_radiance,
):  # fmt: skip
    """Gradients of `forward`; g_radiance [chunks, S, 3] is one zeroed table per chunk of pixels, to be summed.

    Points whose total is 0 get none.
    """
    tolerance = np.float32(tolerance)
    points, parts = len(normal), len(g_radiance)
    for part in prange(parts):
        stack, nodes = np.empty((_STACK, 4), np.int32), np.empty(CAPACITY, np.int32)
        leaves = np.empty((CAPACITY, 5), np.float32)
        table = g_radiance[part]
        for p in range(points * part // parts, points * (part + 1) // parts):
            n, v, nv, r, e = surface_point(normal, view, roughness, ior, p)
            x, y, a2 = frame_x[p], frame_y[p], r * r * r * r
            gn0, gn1, gn2, gv0, gv1, gv2, ga, ge = _ZERO, _ZERO, _ZERO, _ZERO, _ZERO, _ZERO, _ZERO, _ZERO
            count = 0
            if total[p] > _ZERO:
                count = choose(
                    n, v, nv, a2, ggx, place, angle, radius, child, first_root, size, tolerance, most, stack, nodes, leaves
                )  # fmt: skip
            inverse = _ONE / max(total[p], np.float32(1e-30))
            a = (g_value[p, 0], g_value[p, 1], g_value[p, 2])
            b = (g_turned[p, 0, 0], g_turned[p, 0, 1], g_turned[p, 0, 2])
            c = (g_turned[p, 1, 0], g_turned[p, 1, 1], g_turned[p, 1, 2])
            mean = _ZERO
            for k in range(3):
                mean += a[k] * value[p, k] + b[k] * turned[p, 0, k] + c[k] * turned[p, 1, k]
            for k in range(count):
                l, node = (leaves[k, 0], leaves[k, 1], leaves[k, 2]), nodes[k]
                light = (radiance[node, 0], radiance[node, 1], radiance[node, 2])
                d0, d1, d2, d3, d4, d5, d6, d7, r0, r1, r2 = leaf_gradient(
                    n, v, l, nv, a2, e, ggx, leaves[k, 4], leaves[k, 3] * inverse, x, y, light, a, b, c, mean
                )
                gn0, gn1, gn2 = gn0 + d0, gn1 + d1, gn2 + d2
                gv0, gv1, gv2 = gv0 + d3, gv1 + d4, gv2 + d5
                ga, ge = ga + d6, ge + d7
                table[node, 0] += r0
                table[node, 1] += r1
                table[node, 2] += r2
            g_normal[p, 0], g_normal[p, 1], g_normal[p, 2] = gn0, gn1, gn2
            g_view[p, 0], g_view[p, 1], g_view[p, 2] = gv0, gv1, gv2
            g_roughness[p], g_ior[p] = ga * _FOUR * r * r * r, ge
