"""Specular lobes and their derivatives over the lights of one pixel.

Radiance is `rho g E`. With the half vector h in the frame (t, b, n) of the surface and `q = |Lᵀ (h·t, h·b)|²`,
`L = [[e^A, 0], [C, e^B]]` (log-Cholesky of the inverse squared widths: smooth through the round lobe, positive definite):

    WARD            g = exp(-2 q / (1 + h·n)) e^(A+B) / (4 pi n·o)            Ward-Duer with its cosine
    BECKMANN        g = exp(-q / (h·n)²) G1(i) G1(o) e^(A+B) / (4 pi (h·n)⁴ n·o)  microfacets, Smith's G
    GGX             g = G1(i) G1(o) e^(A+B) / (4 pi (q + (h·n)²)² n·o)          microfacets with long tails, Smith's G
    PRINTED         g = exp(-2 q / (1 + h·n)) e^(A+B) / (4 pi sqrt((n·o)(n·i)))   PRF Eq. 14 without a cosine
    PRINTED_COSINE  the printed lobe times n·i

Derivatives are with respect to (d1, d2) = tilt of n along t and b, (A, B, C) and rho. G1 is the rational fit of
Walter et al. 2007, Eq. 27, as renderers use it; GGX's is exact (Heitz 2014).
"""

from __future__ import annotations

import math

from pipeline.kernels.compiling import kernel
from pipeline.rig import lobe_loops as loops
from pipeline.rig.lobe_names import BECKMANN, GGX, PRINTED, PRINTED_COSINE, WARD
from pipeline.rig.lobe_points import smith, smith_ggx

INVERSE_4PI = 1.0 / (4.0 * math.pi)
VIEW_FLOOR = 0.01  # n·o below it (0.6 degrees from grazing) is held there: 1/(n·o) would run away


@kernel(error_model="numpy")
def _common(lobe, frame, shape, o, kind):
    """What all lights of a pixel share: the frame as 9 numbers, (e^A, e^B, C), the factor, and the view's derivatives."""
    ot = frame[0, 0] * o[0] + frame[0, 1] * o[1] + frame[0, 2] * o[2]
    ob = frame[1, 0] * o[0] + frame[1, 1] * o[1] + frame[1, 2] * o[2]
    on = frame[2, 0] * o[0] + frame[2, 1] * o[1] + frame[2, 2] * o[2]
    held = max(on, VIEW_FLOOR)
    free = 1.0 if on > VIEW_FLOOR else 0.0
    a, b, c = math.exp(shape[0]), math.exp(shape[1]), shape[2]
    factor = a * b * INVERSE_4PI / held
    v0, v1, v2, v3, v4 = -free * ot / held, -free * ob / held, 0.0, 0.0, 0.0
    if lobe in (PRINTED, PRINTED_COSINE):
        factor *= math.sqrt(held)
        v0, v1 = 0.5 * v0, 0.5 * v1
    elif lobe == BECKMANN:
        g, s0, s1, v2, v3, v4 = smith(ot, ob, held, a, b, c)
        factor *= g
        v0, v1 = v0 + s0, v1 + s1
    elif lobe == GGX:
        g, s0, s1, v2, v3, v4 = smith_ggx(ot, ob, held, a, b, c)
        factor *= g
        v0, v1 = v0 + s0, v1 + s1
    f = (kind(frame[0, 0]), kind(frame[0, 1]), kind(frame[0, 2]), kind(frame[1, 0]), kind(frame[1, 1]), kind(frame[1, 2]),
         kind(frame[2, 0]), kind(frame[2, 1]), kind(frame[2, 2]))  # fmt: skip
    beckmann = 1.0 if lobe == BECKMANN else 0.0
    flat = 1.0 if lobe == WARD else 0.0
    inverse_root = 1.0 if lobe == PRINTED else 0.0
    root = 1.0 if lobe == PRINTED_COSINE else 0.0
    blend = (
        kind(beckmann),
        kind(1.0 - beckmann),
        kind(flat),
        kind(inverse_root),
        kind(root),
        kind(0.5 * (root - inverse_root)),
    )
    return f, kind(a), kind(b), kind(c), blend, kind(factor), (kind(v0), kind(v1), kind(v2), kind(v3), kind(v4))


@kernel(error_model="numpy")
def values(lobe, frame, shape, o, h, i, out):
    """Evaluate a lobe over the lights of a pixel; device function.

    Args:
        lobe: WARD, BECKMANN or GGX.
        frame: rows t, b, n of the surface, world, float64. [3, 3]
        shape: A, B, C, the log-Cholesky factors of the inverse squared widths, float64. [3]
        o: unit, to the camera. [3]
        h, i: half vectors and directions to the lights, world, each as three contiguous arrays (which lets the loops
            vectorise). [N] each
        out: filled with g. [N]
    """
    f, a, b, c, blend, factor, _ = _common(lobe, frame, shape, o, h[0].dtype.type)
    if lobe == GGX:
        loops.ggx_values(h[0], h[1], h[2], i[0], i[1], i[2], f, a, b, c, blend, factor, out)
    else:
        loops.values(h[0], h[1], h[2], i[0], i[1], i[2], f, a, b, c, blend, factor, out)


@kernel(error_model="numpy")
def normal_equations(lobe, frame, shape, rho, o, h, i, light, floor, weight, isotropic, matrix, gradient):
    """Compute the Gauss-Newton system of half the weighted square residual of `rho g`; device function.

    Args:
        lobe, frame, shape, o, h, i: as in `values`. [...]
        rho: specular albedo.
        light: measured radiance over irradiance. [N]
        floor: 1 where a sample is a lower bound (clipped) and counts only while the lobe stays below it, else 0. [N]
        weight: of the squared residuals. [N]
        isotropic: the lobe is round (A = B, C = 0) and is to stay so: the unknowns are d1, d2, A = B and rho; else d1, d2, A,
            B, C and rho.
        matrix: filled as far as there are unknowns, float64. [6, 6]
        gradient: likewise, float64. [6]

    Returns:
        The cost.
    """
    kind = h[0].dtype.type
    f, a, b, c, blend, factor, v = _common(lobe, frame, shape, o, kind)
    if isotropic and lobe == GGX:
        cost = loops.ggx_round_sums(h[0], h[1], h[2], i[0], i[1], i[2], light, floor, weight, f, a, blend, factor, kind(rho),
                                     v, matrix, gradient)  # fmt: skip
    elif isotropic:
        cost = loops.round_sums(h[0], h[1], h[2], i[0], i[1], i[2], light, floor, weight, f, a, blend, factor, kind(rho), v,
                                matrix, gradient)  # fmt: skip
    elif lobe == GGX:
        cost = loops.ggx_sums(h[0], h[1], h[2], i[0], i[1], i[2], light, floor, weight, f, a, b, c, blend, factor, kind(rho),
                              v, matrix, gradient)  # fmt: skip
    else:
        cost = loops.sums(h[0], h[1], h[2], i[0], i[1], i[2], light, floor, weight, f, a, b, c, blend, factor, kind(rho), v,
                          matrix, gradient)  # fmt: skip
    for row in range(4 if isotropic else 6):
        for column in range(row):
            matrix[row, column] = matrix[column, row]
    return float(cost)


@kernel(error_model="numpy")
def jacobian(lobe, frame, shape, o, h, i, out):
    """Compute the derivatives of a lobe over the lights of a pixel; device function.

    Args:
        lobe, frame, shape, o, h, i: as in `values`. [...]
        out: filled with the derivatives of g by d1, d2, A, B, C, and g itself in the last row. [6, N]
    """
    f, a, b, c, blend, factor, v = _common(lobe, frame, shape, o, h[0].dtype.type)
    if lobe == GGX:
        loops.ggx_rows(h[0], h[1], h[2], i[0], i[1], i[2], f, a, b, c, blend, factor, v, out)
    else:
        loops.rows(h[0], h[1], h[2], i[0], i[1], i[2], f, a, b, c, blend, factor, v, out)
