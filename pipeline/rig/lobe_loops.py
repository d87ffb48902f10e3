"""The loops over a pixel's lights: lobe values, derivatives and normal equations. See `lobes` for the formulas.

They only read and sum: that is what lets them vectorise.
"""

from __future__ import annotations

from pipeline.kernels.compiling import kernel
from pipeline.kernels.numerics import FAST, ZERO
from pipeline.rig.lobe_points import ggx_point, shared_point


@kernel(fastmath=FAST, error_model="numpy", inline="always")
def _weighed(residual, floor, weight):
    """A residual and its weight: a clipped sample (`floor` not 0) counts where the lobe stays below it."""
    r = residual if floor == ZERO else min(residual, ZERO)
    return r, weight if floor == ZERO else (weight if r < ZERO else ZERO)


def _compiled(form):
    """Decorator: compile a loop for one form of the lobe, apart from the others: a branch inside would not vectorise."""

    def compiled(function):
        function.__qualname__ = f"{function.__name__}_{form}"  # what it is kept on disk as
        return kernel(fastmath=FAST, error_model="numpy")(function)

    return compiled


def _loops(form, point):
    """Values, derivatives and normal equations of one form of the lobe."""
    compiled = _compiled(form)

    @compiled
    def values(h0, h1, h2, i0, i1, i2, f, ea, eb, c, kind, factor, out):
        for k in range(h0.size):
            out[k] = factor * point(h0[k], h1[k], h2[k], i0[k], i1[k], i2[k], f, ea, eb, c, kind)[0]

    @compiled
    def rows(h0, h1, h2, i0, i1, i2, f, ea, eb, c, kind, factor, v, out):
        for k in range(h0.size):
            g, l0, l1, l2, l3, l4 = point(h0[k], h1[k], h2[k], i0[k], i1[k], i2[k], f, ea, eb, c, kind)
            g *= factor
            out[0, k], out[1, k], out[2, k] = g * (l0 + v[0]), g * (l1 + v[1]), g * (l2 + v[2])
            out[3, k], out[4, k], out[5, k] = g * (l3 + v[3]), g * (l4 + v[4]), g

    @compiled
    def sums(h0, h1, h2, i0, i1, i2, light, floor, weight, f, ea, eb, c, kind, factor, rho, v, matrix, gradient):
        s00 = s01 = s02 = s03 = s04 = s05 = s11 = s12 = s13 = s14 = s15 = ZERO * ea
        s22 = s23 = s24 = s25 = s33 = s34 = s35 = s44 = s45 = s55 = ZERO * ea
        b0 = b1 = b2 = b3 = b4 = b5 = cost = ZERO * ea
        for k in range(light.size):
            g, l0, l1, l2, l3, l4 = point(h0[k], h1[k], h2[k], i0[k], i1[k], i2[k], f, ea, eb, c, kind)
            j5 = factor * g
            p = rho * j5
            r, w = _weighed(p - light[k], floor[k], weight[k])
            d = w * r
            cost += d * r
            j0, j1, j2, j3, j4 = p * (l0 + v[0]), p * (l1 + v[1]), p * (l2 + v[2]), p * (l3 + v[3]), p * (l4 + v[4])
            b0 += d * j0
            b1 += d * j1
            b2 += d * j2
            b3 += d * j3
            b4 += d * j4
            b5 += d * j5
            w0, w1, w2, w3, w4, w5 = w * j0, w * j1, w * j2, w * j3, w * j4, w * j5
            s00 += w0 * j0
            s01 += w0 * j1
            s02 += w0 * j2
            s03 += w0 * j3
            s04 += w0 * j4
            s05 += w0 * j5
            s11 += w1 * j1
            s12 += w1 * j2
            s13 += w1 * j3
            s14 += w1 * j4
            s15 += w1 * j5
            s22 += w2 * j2
            s23 += w2 * j3
            s24 += w2 * j4
            s25 += w2 * j5
            s33 += w3 * j3
            s34 += w3 * j4
            s35 += w3 * j5
            s44 += w4 * j4
            s45 += w4 * j5
            s55 += w5 * j5
        m, b = matrix, gradient
        b[0], b[1], b[2], b[3], b[4], b[5] = b0, b1, b2, b3, b4, b5
        m[0, 0], m[0, 1], m[0, 2], m[0, 3], m[0, 4], m[0, 5] = s00, s01, s02, s03, s04, s05
        m[1, 1], m[1, 2], m[1, 3], m[1, 4], m[1, 5] = s11, s12, s13, s14, s15
        m[2, 2], m[2, 3], m[2, 4], m[2, 5] = s22, s23, s24, s25
        m[3, 3], m[3, 4], m[3, 5], m[4, 4], m[4, 5], m[5, 5] = s33, s34, s35, s44, s45, s55
        return cost

    return values, rows, sums


def _round_loop(form, point):
    """Normal equations of a round lobe of one form, whose widths are one unknown: 15 sums where `_loops` has 28."""

    @_compiled(form)
    def round_sums(h0, h1, h2, i0, i1, i2, light, floor, weight, f, ea, kind, factor, rho, v, matrix, gradient):
        s00 = s01 = s02 = s03 = s11 = s12 = s13 = s22 = s23 = s33 = b0 = b1 = b2 = b3 = cost = ZERO * ea
        width = v[2] + v[3]
        for k in range(light.size):
            g, l0, l1, l2, l3, _ = point(h0[k], h1[k], h2[k], i0[k], i1[k], i2[k], f, ea, ea, ZERO * ea, kind)
            j3 = factor * g
            p = rho * j3
            r, w = _weighed(p - light[k], floor[k], weight[k])
            d = w * r
            cost += d * r
            j0, j1, j2 = p * (l0 + v[0]), p * (l1 + v[1]), p * (l2 + l3 + width)
            b0 += d * j0
            b1 += d * j1
            b2 += d * j2
            b3 += d * j3
            w0, w1, w2, w3 = w * j0, w * j1, w * j2, w * j3
            s00 += w0 * j0
            s01 += w0 * j1
            s02 += w0 * j2
            s03 += w0 * j3
            s11 += w1 * j1
            s12 += w1 * j2
            s13 += w1 * j3
            s22 += w2 * j2
            s23 += w2 * j3
            s33 += w3 * j3
        m, b = matrix, gradient
        b[0], b[1], b[2], b[3] = b0, b1, b2, b3
        m[0, 0], m[0, 1], m[0, 2], m[0, 3], m[1, 1], m[1, 2], m[1, 3] = s00, s01, s02, s03, s11, s12, s13
        m[2, 2], m[2, 3], m[3, 3] = s22, s23, s33
        return cost

    return round_sums


values, rows, sums = _loops("shared", shared_point)
ggx_values, ggx_rows, ggx_sums = _loops("ggx", ggx_point)
round_sums, ggx_round_sums = _round_loop("shared", shared_point), _round_loop("ggx", ggx_point)
