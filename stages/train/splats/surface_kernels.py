"""Numba kernels over the surface graph: the fused losses with their gradients, and diffusion.

Twins: surface_losses.py, surface_graph.py.

Each splat gathers from its neighbours (every edge is seen from both ends), so rows are independent and the result does
not depend on how threads share them.
"""

from __future__ import annotations

import numpy as np

from pipeline.kernels.compiling import kernel

PARTS = 5  # slope, normal turn, albedo variation, offset differences, offset size


@kernel(nogil=True, error_model="numpy", fastmath={"contract", "reassoc", "nsz"})
def surface_losses_rows(
    first, last, indptr, indices, position, normal, albedo, offset, weights, widths, sums,
    g_position, g_normal, g_albedo, g_offset,
):  # fmt: skip
    """Weighted loss terms and gradients of rows first..last; `sums` [PARTS] float64 accumulates halves of each edge.

    weights [PARTS]: factor of each term's sum over edges (the last: over rows); widths: robust widths of the first three.
    """
    for i in range(first, last):
        px, py, pz = position[i, 0], position[i, 1], position[i, 2]
        nx, ny, nz = normal[i, 0], normal[i, 1], normal[i, 2]
        gpx = gpy = gpz = gnx = gny = gnz = np.float32(0.0)
        ga0 = ga1 = ga2 = go0 = go1 = np.float32(0.0)
        for e in range(indptr[i], indptr[i + 1]):
            j = indices[e]
            # chord seen from i; from j it is the negative, and so is the residual: the term is even
            cx, cy, cz = position[j, 0] - px, position[j, 1] - py, position[j, 2] - pz
            sx, sy, sz = nx + normal[j, 0], ny + normal[j, 1], nz + normal[j, 2]
            length2 = cx * cx + cy * cy + cz * cz
            inverse = np.float32(0.5) / np.sqrt(length2 + np.float32(1e-20))  # coincident splats: no chord, no term
            dot = cx * sx + cy * sy + cz * sz
            r = dot * inverse
            root = np.sqrt(r * r + widths[0] * widths[0])
            sums[0] += 0.5 * (root - widths[0])
            w = weights[0] * r / root * inverse
            gpx -= w * sx
            gpy -= w * sy
            gpz -= w * sz
            gnx += w * cx
            gny += w * cy
            gnz += w * cz
            dx, dy, dz = normal[j, 0] - nx, normal[j, 1] - ny, normal[j, 2] - nz
            root = np.sqrt(dx * dx + dy * dy + dz * dz + widths[1] * widths[1])
            sums[1] += 0.5 * (root - widths[1])
            w = weights[1] / root
            gnx -= w * dx
            gny -= w * dy
            gnz -= w * dz
            a0, a1, a2 = albedo[j, 0] - albedo[i, 0], albedo[j, 1] - albedo[i, 1], albedo[j, 2] - albedo[i, 2]
            root = np.sqrt(a0 * a0 + a1 * a1 + a2 * a2 + widths[2] * widths[2])
            sums[2] += 0.5 * (root - widths[2])
            w = weights[2] / root
            ga0 -= w * a0
            ga1 -= w * a1
            ga2 -= w * a2
            o0, o1 = offset[j, 0] - offset[i, 0], offset[j, 1] - offset[i, 1]
            sums[3] += 0.5 * (o0 * o0 + o1 * o1)
            go0 -= weights[3] * 2 * o0
            go1 -= weights[3] * 2 * o1
        sums[4] += offset[i, 0] * offset[i, 0] + offset[i, 1] * offset[i, 1]
        go0 += weights[4] * 2 * offset[i, 0]
        go1 += weights[4] * 2 * offset[i, 1]
        g_position[i, 0], g_position[i, 1], g_position[i, 2] = gpx, gpy, gpz
        g_normal[i, 0], g_normal[i, 1], g_normal[i, 2] = gnx, gny, gnz
        g_albedo[i, 0], g_albedo[i, 1], g_albedo[i, 2] = ga0, ga1, ga2
        g_offset[i, 0], g_offset[i, 1] = go0, go1


@kernel(nogil=True, error_model="numpy", fastmath={"contract", "reassoc", "nsz"})
def diffuse_rows(first, last, indptr, indices, values, out):
    """out[i] = half its own value and half its neighbours' mean, for rows first..last of [N, C]."""
    half, none = np.float32(0.5), np.float32(0)
    for i in range(first, last):
        degree = indptr[i + 1] - indptr[i]
        own, share = (half, half / np.float32(degree)) if degree else (np.float32(1), none)
        for c in range(0, values.shape[1] - 2, 3):  # three at once: each neighbour is fetched once
            a = b = d = none
            for e in range(indptr[i], indptr[i + 1]):
                j = indices[e]
                a += values[j, c]
                b += values[j, c + 1]
                d += values[j, c + 2]
            out[i, c] = own * values[i, c] + share * a
            out[i, c + 1] = own * values[i, c + 1] + share * b
            out[i, c + 2] = own * values[i, c + 2] + share * d
        for c in range(values.shape[1] - values.shape[1] % 3, values.shape[1]):
            total = none
            for e in range(indptr[i], indptr[i + 1]):
                total += values[indices[e], c]
            out[i, c] = own * values[i, c] + share * total


@kernel(nogil=True, error_model="numpy", fastmath={"contract", "nsz"})
def steps(values, edges, width, gradient):
    """Sum of the robust differences of values [M, 3] along edges [2, E], in their order; `gradient` [M, 3], zeroed, adds up."""
    total = 0.0
    for e in range(edges.shape[1]):
        i, j = edges[0, e], edges[1, e]
        for c in range(3):
            r = values[j, c] - values[i, c]
            root = np.sqrt(r * r + width * width)
            total += root - width
            g = r / root
            gradient[j, c] += g
            gradient[i, c] -= g
    return total
