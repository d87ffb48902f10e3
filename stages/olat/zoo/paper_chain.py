"""PRF 4.3 with one of the zoo's solvers, on a band of pixels: n_d, rho_d, n_s, sigma, rho_s, correlation fusion."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pipeline.rig.light_table import LightTable
from stages.olat.pixel_fit.diffuse import SHADOWED
from stages.olat.pixel_fit.fit_options import FitOptions
from stages.olat.pixel_fit.many_pixels import half_table
from stages.olat.pixel_fit.result_layout import map_slices
from stages.olat.zoo.solvers import applies, scaled, solve

FALLBACK = "lbfgs-backtracking"  # where Gauss-Newton does not apply (PRF's own choice for normals)
BEHIND = -0.25  # cosine below which a light is surely behind the surface: what arrives from there is noise
NOISE_FLOOR = 1e-3  # of the brightest sample: half floats are this coarse
SIGMA_START, SIGMA_RANGE = 0.3, (1e-3, 10.0)


def solve_band(
    solver: str, cross: NDArray, parallel: NDArray, view: NDArray, rig: LightTable, settings: FitOptions, rows: NDArray,
    points: NDArray | None = None,
) -> None:  # fmt: skip
    """Replace normals, albedos and widths in the closed chain's `rows` [P, WIDTH] by the solver's, in place.

    cross, parallel [N, P, 3] (half-float bits or floats), view [P, 3], points [P, 3]: where each pixel's surface is, for near
    lights. Which lights reach a pixel, occlusion, inter-reflection and flags stay the closed chain's. Pixels that it flags keep
    its values: their problems have no solution to find.
    """
    at = map_slices()
    good = rows[:, at["residual"]][:, 1] == 0
    if not good.any():
        return
    w, energy = lights_of(rig, None if points is None else points[good], settings.irradiance)
    rgb, shine, fine = separated(_floats(cross[:, good]), _floats(parallel[:, good]), rig, energy, settings)
    light, shared = rgb.mean(-1), ("w",) if w.ndim == 2 else ()
    o = view[good].astype(np.float32)
    area = rig.solid_angle.astype(np.float32)  # type: ignore[union-attr]

    def run(quantity: str, start: NDArray, problem: dict[str, NDArray]) -> NDArray:
        chosen = solver if applies(solver, quantity) else FALLBACK
        floats = {k: v.astype(np.float32) for k, v in problem.items()}
        return solve(chosen, quantity, start.astype(np.float32), floats, shared)

    start = unit(moment(light * area, w))
    use = (cosines(start, w) > 0) & fine & reached(light, cosines(rows[good, at["diffuse_normal"]], w))
    n_d = unit(run("n_d", start, {"w": w, "use": use, "data": scaled(light, use)[0]}))
    use &= cosines(n_d, w) > 0
    for c in range(3):
        data, norm = scaled(rgb[..., c], use)
        rho = run("rho_d", np.zeros((len(o), 1)), {"w": w, "use": use, "data": data, "n_d": n_d})
        rows[np.flatnonzero(good), at["diffuse_albedo"].start + c] = np.maximum((rho * norm)[:, 0], 0)
    start = unit(unit(moment(shine * area, w)) + o)
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
    put = {"diffuse_normal": n_d, "specular_normal": n_s, "specular_albedo": np.maximum(rho, 0), **widths_of(sigma, t, b)}
    score_d = (scaled(light, use)[0] * scaled(cosines(n_d, w), use)[0]).sum(1, keepdims=True)
    score_s = (data * g / size).sum(1, keepdims=True)
    put["normal"] = unit(score_d * n_d + score_s * n_s)
    for name, values in put.items():
        rows[good, at[name]] = np.nan_to_num(values)


def lights_of(rig: LightTable, points: NDArray | None, irradiance: float) -> tuple[NDArray, NDArray]:
    """Directions [N, 3] and irradiances [1, N] of distant lights; of near ones [P, N, 3] and [P, N] (inverse square)."""
    if points is None:
        return rig.directions.astype(np.float32), (irradiance * rig.intensity).astype(np.float32)[None]
    away = rig.positions[None] - points[:, None]
    square = np.sum(away * away, -1)
    falls = np.sum(rig.positions**2, -1) / square
    return (away / np.sqrt(square)[..., None]).astype(np.float32), (irradiance * rig.intensity * falls).astype(np.float32)


def separated(
    cross: NDArray, parallel: NDArray, rig: LightTable, energy: NDArray, settings: FitOptions
) -> tuple[NDArray, NDArray, NDArray]:
    """Diffuse samples [P, N, 3] in albedo units, specular ones [P, N], and which are finite and not clipped [P, N]."""
    x, y = (np.moveaxis(samples, 0, 1) for samples in (cross, parallel))
    fine = np.isfinite(x).all(-1) & np.isfinite(y).all(-1) & (np.maximum(x, y).max(-1) < settings.saturation)
    x, y = (samples * rig.gains.astype(np.float32) / energy[..., None] for samples in (x, y))
    rgb = np.nan_to_num(2 * np.pi * x, posinf=0, neginf=0) * fine[..., None]
    shine = np.nan_to_num(settings.specular_factor * (y - x).mean(-1), posinf=0, neginf=0) * fine
    return rgb.astype(np.float32), shine.astype(np.float32), fine


def cosines(n: NDArray, w: NDArray) -> NDArray:
    """n·w [P, N] of normals [P, 3] and directions [N, 3] or [P, N, 3]."""
    return n @ w.T if w.ndim == 2 else np.einsum("pc,pnc->pn", n, w)


def moment(weight: NDArray, w: NDArray) -> NDArray:
    """Sum of the directions [P, 3] by weights [P, N]."""
    return weight @ w if w.ndim == 2 else np.einsum("pn,pnc->pc", weight, w)


def reached(light: NDArray, cosine: NDArray) -> NDArray:
    """Which lights reach each pixel [P, N], as in `light_visibility`: half of what is predicted arrives, or is below noise."""
    front, behind = np.maximum(cosine, 0), cosine < BEHIND
    albedo = np.sum(light * front, 1, keepdims=True) / np.maximum(np.sum(front * front, 1, keepdims=True), 1e-12)
    square = np.sum(light * light * behind, 1, keepdims=True) / np.maximum(behind.sum(1, keepdims=True), 1)
    floor = 4 * np.sqrt(square) + 2 * NOISE_FLOOR * light.max(1, keepdims=True)
    return (light > SHADOWED * albedo * front) | (albedo * front < floor)


def widths_of(sigma: NDArray, t: NDArray, b: NDArray) -> dict[str, NDArray]:
    """The maps of widths [P, 2] along t and b [P, 3]: larger first, the tangent along it."""
    return {
        "sigma": np.sort(sigma, 1)[:, ::-1], "tangent": np.where(sigma[:, :1] >= sigma[:, 1:], t, b),
        "roughness": (sigma[:, :1] * sigma[:, 1:]) ** 0.25,
        "anisotropy": np.abs(sigma[:, :1] - sigma[:, 1:]) / sigma.sum(1)[:, None],
    }  # fmt: skip


def ward(sigma: NDArray, p: dict[str, NDArray]) -> NDArray:
    """Ward's radiance lobe [P, N] per unit irradiance at widths [P, 2] in the frames of `p`."""
    h = (p["w"] if p["w"].ndim == 3 else p["w"][None]) + p["o"][:, None]
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
