"""PRF's five objectives per pixel (Eqs. 12, 13, 14, 16, 17), for jax: what the solver zoo minimises.

Each takes the unknowns `x` and one pixel's problem: `w` [N, 3] directions to the lights, `use` [N] 0/1 the lights that count,
`data` [N] samples scaled to unit norm over them, `o` [3] to the camera, and what was found before.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax.numpy as jnp

Problem = dict[str, Any]
SMALL = 1e-12  # under square roots: their gradient at an all-dark pixel would be 0/0


def _unit(v: Any) -> Any:
    return v / jnp.sqrt(jnp.sum(v * v) + SMALL)


def _miss(model: Any, p: Problem) -> Any:
    """1 - correlation of the model with the data over the lights in use."""
    m = model * p["use"]
    return 1.0 - jnp.sum(m * p["data"]) / jnp.sqrt(jnp.sum(m * m) + SMALL)


def diffuse_normal(x: Any, p: Problem) -> Any:
    """Eq. 12: unknown n [3]."""
    return _miss(p["w"] @ _unit(x), p)


def specular_normal(x: Any, p: Problem) -> Any:
    """Eq. 13: unknown n [3]; cosine of the mirrored light direction with the view."""
    n = _unit(x)
    return _miss(2.0 * (p["w"] @ n) * jnp.dot(n, p["o"]) - p["w"] @ p["o"], p)


def diffuse_albedo_residual(x: Any, p: Problem) -> Any:
    """Eq. 16: unknown rho [1], n_d found."""
    return (x[0] * (p["w"] @ p["n_d"]) - p["data"]) * p["use"]


def lobe(log_sigma: Any, p: Problem) -> Any:
    """Ward's radiance lobe [N] at the found normal and tangent."""
    h = p["w"] + p["o"]
    h = h / jnp.sqrt(jnp.sum(h * h, -1, keepdims=True) + SMALL)
    s = jnp.exp(log_sigma)
    q = (h @ p["t"] / s[0]) ** 2 + (h @ p["b"] / s[1]) ** 2
    return jnp.exp(-2.0 * q / (1.0 + h @ p["n_s"])) / (s[0] * s[1])


def sigma_residual(x: Any, p: Problem) -> Any:
    """Eq. 14: unknown log sigma [2]; normalised lobe against normalised data."""
    m = lobe(x, p) * p["use"]
    return (m / jnp.sqrt(jnp.sum(m * m) + SMALL) - p["data"]) * p["use"]


def specular_albedo_residual(x: Any, p: Problem) -> Any:
    """Eq. 17: unknown rho [1]; n_s and sigma found (the lobe given as `g` [N], scaled to unit norm)."""
    return (x[0] * p["g"] - p["data"]) * p["use"]


def half_square(residual: Callable) -> Callable:
    """The scalar objective of a residual."""
    return lambda x, p: 0.5 * jnp.sum(residual(x, p) ** 2)


OBJECTIVES: dict[str, Callable] = {
    "n_d": diffuse_normal,
    "rho_d": half_square(diffuse_albedo_residual),
    "n_s": specular_normal,
    "rho_s": half_square(specular_albedo_residual),
    "sigma": half_square(sigma_residual),
}
RESIDUALS: dict[str, Callable] = {
    "rho_d": diffuse_albedo_residual,
    "rho_s": specular_albedo_residual,
    "sigma": sigma_residual,
}
