"""PRF's five problems (Eqs. 12, 13, 14, 16, 17) for pixels with known truth, and how far an answer is from a solution.

In float64 numpy: the independent twin of the objectives that the solver zoo minimises.
"""

from __future__ import annotations

import numpy as np

from synth.olat_pixels import Pixels


def scaled(data: np.ndarray, use: np.ndarray) -> np.ndarray:
    """Samples [P, N] with the unused at 0 and unit norm per pixel."""
    data = data * use
    return data / np.maximum(np.linalg.norm(data, axis=1, keepdims=True), np.finfo(float).tiny)


def problems(p: Pixels) -> tuple[dict[str, dict[str, np.ndarray]], dict[str, np.ndarray], np.ndarray]:
    """PRF's five problems for these pixels at the true normals' active sets, their starts, and the diffuse samples."""
    w = p.rig.directions
    light = 2 * p.cross.mean(-1).T
    shine = (2 * (p.parallel - p.cross)).mean(-1).T / np.pi
    use = (p.normal @ w.T > 0).astype(float)
    data_d, data_s = scaled(light, use), scaled(shine, use)
    b = np.cross(p.normal, p.tangent)
    h = w[None] + p.view[:, None]
    h /= np.linalg.norm(h, axis=-1, keepdims=True)
    x, y, z = (np.einsum("pni,pi->pn", h, v) for v in (p.tangent, b, p.normal))
    g = np.exp(-2 * ((x / p.sigma[:, :1]) ** 2 + (y / p.sigma[:, 1:]) ** 2) / (1 + z)) * use
    g /= np.linalg.norm(g, axis=1, keepdims=True)
    base = {"w": w, "use": use}
    found = {
        "n_d": {**base, "data": data_d},
        "rho_d": {**base, "data": data_d, "n_d": p.normal},
        "n_s": {**base, "data": data_s, "o": p.view},
        "rho_s": {**base, "data": data_s, "g": g},
        "sigma": {**base, "data": data_s, "o": p.view, "n_s": p.normal, "t": p.tangent, "b": b},
    }
    n = (light * p.rig.solid_angle) @ w
    m = (shine * p.rig.solid_angle) @ w
    n, m = n / np.linalg.norm(n, axis=1, keepdims=True), m / np.linalg.norm(m, axis=1, keepdims=True) + p.view
    one, two = np.zeros((len(n), 1)), np.full((len(n), 2), np.log(0.3))
    return found, {"n_d": n, "rho_d": one, "n_s": m, "rho_s": one, "sigma": two}, light


def objective(quantity: str, x: np.ndarray, p: dict[str, np.ndarray]) -> float:
    """PRF's objectives in float64 numpy at one pixel."""
    w, use, data = p["w"], p["use"], p["data"]
    if quantity in ("n_d", "n_s"):
        n = x / np.linalg.norm(x)
        m = (w @ n if quantity == "n_d" else 2 * (w @ n) * (n @ p["o"]) - w @ p["o"]) * use
        return 1 - m @ data / np.linalg.norm(m)
    if quantity == "rho_d":
        return 0.5 * np.sum(((x[0] * (w @ p["n_d"]) - data) * use) ** 2)
    if quantity == "rho_s":
        return 0.5 * np.sum(((x[0] * p["g"] - data) * use) ** 2)
    h = w + p["o"]
    h = h / np.linalg.norm(h, axis=1, keepdims=True)
    s = np.exp(x)
    m = np.exp(-2 * ((h @ p["t"] / s[0]) ** 2 + (h @ p["b"] / s[1]) ** 2) / (1 + h @ p["n_s"])) * use
    return 0.5 * np.sum(((m / np.linalg.norm(m) - data) * use) ** 2)


def gradient_norms(quantity: str, x: np.ndarray, problem: dict[str, np.ndarray]) -> float:
    """Mean gradient norm of PRF's objective in float64 at float32 answers, by central differences along the unknowns."""
    step, total = 1e-6, []
    for p in range(len(x)):
        one = {k: np.asarray(v if k == "w" else v[p], float) for k, v in problem.items()}
        norm = np.linalg.norm(one["data"] * one["use"])
        one["data"] = one["data"] / norm if norm > 0 else one["data"]
        at = np.asarray(x[p], float)
        parts = []
        for k in range(len(at)):
            d = np.zeros_like(at)
            d[k] = step
            parts.append((objective(quantity, at + d, one) - objective(quantity, at - d, one)) / (2 * step))
        total.append(np.linalg.norm(parts))
    return float(np.mean(total))


def linear_gradient(x: np.ndarray, p: dict[str, np.ndarray]) -> float:
    """Mean absolute gradient of `0.5 |x model - data|^2` over the lights in use: exact, not by differences."""
    residual = (x * p["model"] - p["data"]) * p["use"]
    return float(np.mean(np.abs(np.sum(residual * p["model"], 1))))
