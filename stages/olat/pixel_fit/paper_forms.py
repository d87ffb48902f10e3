"""The paper's own forms, kept as named options and as fallbacks: gradient normals, Eq. 13, correlation scores."""

from __future__ import annotations

import math

from pipeline.kernels.compiling import kernel
from pipeline.kernels.numerics import LARGEST, ONE, ZERO, solve3
from stages.olat.pixel_fit.diffuse import weighted_equations


@kernel(error_model="numpy")
def gradient_direction(light, ok, w, area):
    """PRF Eqs. 8-10 (Ma et al. 2007): normalised `Σ I ω ΔΩ`. Returns (x, y, z, found)."""
    x = y = z = 0.0
    for k in range(light.size):
        v = light[k] * ok[k] * area[k]
        x += v * w[0, k]
        y += v * w[1, k]
        z += v * w[2, k]
    size = math.sqrt(x * x + y * y + z * z)
    return (x / size, y / size, z / size, True) if size > 0 else (0.0, 0.0, 0.0, False)


@kernel(error_model="numpy")
def total(light, ok, area):
    """Solid-angle-weighted sum of the samples (PRF Eqs. 6 and 7)."""
    s = 0.0
    for k in range(light.size):
        s += light[k] * ok[k] * area[k]
    return s


@kernel(error_model="numpy")
def correlation_normal(light, use, incident, o, weight):
    """PRF Eq. 13: the reflected direction whose cosine correlates best, `r ∝ (ΩᵀΩ)⁻¹ Ωᵀ I`, and `n = N(r + o)`.

    `weight` [N] is workspace.
    """
    a, b, c, d, e, f, x, y, z, _, _ = weighted_equations(
        light, use, incident[0], incident[1], incident[2], ZERO, ZERO, ZERO, -ONE, ZERO, -LARGEST, ZERO, weight
    )
    rx, ry, rz, found = solve3(a, b, c, d, e, f, x, y, z)
    size = math.sqrt(rx * rx + ry * ry + rz * rz)
    if not found or size == 0:
        return 0.0, 0.0, 0.0, False
    nx, ny, nz = rx / size + o[0], ry / size + o[1], rz / size + o[2]
    size = math.sqrt(nx * nx + ny * ny + nz * nz)
    return (nx / size, ny / size, nz / size, True) if size > 1e-6 else (0.0, 0.0, 0.0, False)


@kernel(error_model="numpy")
def correlation(model, light, use):
    """Cosine between a model's values and the samples over the lights in use (PRF Eqs. 12 and 13)."""
    ab = aa = bb = 0.0
    for k in range(light.size):
        u = use[k]
        ab += u * model[k] * light[k]
        aa += u * model[k] * model[k]
        bb += u * light[k] * light[k]
    return ab / math.sqrt(aa * bb) if aa > 0 and bb > 0 else 0.0


@kernel(error_model="numpy")
def lambert(n, w, out):
    """Clamped cosines of the lights into `out`."""
    for k in range(out.size):
        out[k] = max(n[0] * w[0, k] + n[1] * w[1, k] + n[2] * w[2, k], 0.0)
