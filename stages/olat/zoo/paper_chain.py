"""PRF 4.3 with one of the zoo's solvers, on a band of pixels: n_d, rho_d, n_s, sigma, rho_s, correlation fusion."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pipeline.rig.light_table import LightTable
from stages.olat.pixel_fit.fit_options import FitOptions
from stages.olat.pixel_fit.many_pixels import half_table
from stages.olat.pixel_fit.result_layout import map_slices
from stages.olat.zoo.solvers import applies, scaled, solve

FALLBACK = "lbfgs-backtracking"  # where Gauss-Newton does not apply (PRF's own choice for normals)
SIGMA_START, SIGMA_RANGE = 0.3, (1e-3, 10.0)


def solve_band(
    solver: str, cross: NDArray, parallel: NDArray, view: NDArray, rig: LightTable, settings: FitOptions, rows: NDArray
) -> None:
    """Replace normals, albedos and widths in the closed chain's `rows` [P, WIDTH] by the solver's, in place.

    cross, parallel [N, P, 3] (half-float bits or floats), view [P, 3]. Visibility, occlusion, inter-reflection and flags stay
    the closed chain's. Pixels that it flags keep its values: their problems have no solution to find.
    """
    at = map_slices()
    good = rows[:, at["residual"]][:, 1] == 0
    if not good.any():
        return
    x, y = _floats(cross[:, good]), _floats(parallel[:, good])
    w = rig.directions.astype(np.float32)
    energy = (settings.irradiance * rig.intensity).astype(np.float32)[:, None]
    fine = np.isfinite(x).all(-1) & np.isfinite(y).all(-1) & (np.maximum(x, y).max(-1) < settings.saturation)
    rgb = np.nan_to_num(2 * np.pi * x / energy[..., None]) * fine[..., None]
    shine = np.nan_to_num(settings.specular_factor * (y - x).mean(-1) / energy) * fine
    light, shine = np.ascontiguousarray(rgb.mean(-1).T), np.ascontiguousarray(shine.T)
    o = view[good].astype(np.float32)
    area = rig.solid_angle.astype(np.float32)  # type: ignore[union-attr]

    def run(quantity: str, start: NDArray, problem: dict[str, NDArray]) -> NDArray:
        chosen = solver if applies(solver, quantity) else FALLBACK
        return solve(chosen, quantity, start.astype(np.float32), {k: v.astype(np.float32) for k, v in problem.items()})

    start = unit((light * area) @ w)
    use = (start @ w.T > 0) & fine.T
    n_d = unit(run("n_d", start, {"w": w, "use": use, "data": scaled(light, use)[0]}))
    use = (n_d @ w.T > 0) & fine.T
    for c in range(3):
        data, norm = scaled(np.ascontiguousarray(rgb[..., c].T), use)
        rho = run("rho_d", np.zeros((len(o), 1)), {"w": w, "use": use, "data": data, "n_d": n_d})
        rows[np.flatnonzero(good), at["diffuse_albedo"].start + c] = np.maximum((rho * norm)[:, 0], 0)
    start = unit(unit((shine * area) @ w) + o)
    data, norm = scaled(shine, use)
    n_s = unit(run("n_s", start, {"w": w, "use": use, "data": data, "o": o}))
    t = unit(np.cross(np.where(np.abs(n_s[:, 1:2]) < 0.9, [[0, 1, 0]], [[1, 0, 0]]), n_s))
    b = np.cross(n_s, t)
    frame = {"w": w, "use": use, "data": data, "o": o, "n_s": n_s, "t": t, "b": b}
    log_sigma = run("sigma", np.full((len(o), 2), np.log(SIGMA_START)), frame)
    sigma = np.clip(np.nan_to_num(np.exp(log_sigma), nan=SIGMA_START), *SIGMA_RANGE)
    g = ward(sigma, frame) * use
    size = np.maximum(np.linalg.norm(g, axis=1, keepdims=True), np.finfo(np.float32).tiny)
    rho = run("rho_s", np.zeros((len(o), 1)), {"w": w, "use": use, "data": data, "g": g / size}) * norm / size
    large = sigma[:, :1] >= sigma[:, 1:]
    put = {
        "diffuse_normal": n_d, "specular_normal": n_s, "specular_albedo": np.maximum(rho, 0),
        "sigma": np.sort(sigma, 1)[:, ::-1], "tangent": np.where(large, t, b),
        "roughness": (sigma[:, :1] * sigma[:, 1:]) ** 0.25,
        "anisotropy": np.abs(sigma[:, :1] - sigma[:, 1:]) / sigma.sum(1)[:, None],
    }  # fmt: skip
    score_d = (scaled(light, use)[0] * scaled(n_d @ w.T, use)[0]).sum(1, keepdims=True)
    score_s = (data * g / size).sum(1, keepdims=True)
    put["normal"] = unit(score_d * n_d + score_s * n_s)
    for name, values in put.items():
        rows[good, at[name]] = np.nan_to_num(values)


def ward(sigma: NDArray, p: dict[str, NDArray]) -> NDArray:
    """Ward's radiance lobe [P, N] per unit irradiance at widths [P, 2] in the frames of `p`."""
    h = p["w"][None] + p["o"][:, None]
    h /= np.maximum(np.linalg.norm(h, axis=-1, keepdims=True), 1e-6)
    x, y, z = (np.einsum("pni,pi->pn", h, p[k]) for k in ("t", "b", "n_s"))
    q = (x / sigma[:, :1]) ** 2 + (y / sigma[:, 1:]) ** 2
    cosine = np.maximum(np.sum(p["n_s"] * p["o"], 1), 0.01)[:, None]
    return np.exp(-2 * q / (1 + z)) / (4 * np.pi * sigma[:, :1] * sigma[:, 1:] * cosine)


def unit(v: NDArray) -> NDArray:
    """Vectors [P, 3] to unit length; a zero vector stays."""
    return v / np.maximum(np.linalg.norm(v, axis=-1, keepdims=True), np.finfo(np.float32).tiny)


def _floats(samples: NDArray) -> NDArray[np.float32]:
    return half_table()[samples] if samples.dtype == np.uint16 else samples.astype(np.float32)
