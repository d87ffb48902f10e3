"""PRF's Table 3 rerun: seconds a pixel and gradient norm at the end, published solvers beside the closed forms."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from benchmarks.olat_settings import AT, SETTINGS, timed
from stages.olat.pixel_fit.diffuse import fit_normal
from stages.olat.pixel_fit.lobe_fit import linear_albedo
from stages.olat.pixel_fit.many_pixels import fit
from stages.olat.zoo.solvers import applies, solve
from synth.olat_pixels import Pixels, ward
from synth.olat_problems import gradient_norms, linear_gradient, problems

PUBLISHED = {  # PRF Table 3, RTX A6000: seconds a pixel, gradient norm
    "lbfgs-backtracking": {"n_d": (1.54e-6, 3.60e-4), "rho_d": (1.63e-6, 3.73), "n_s": (1.75e-5, 2.02e-3),
                           "rho_s": (8.21e-6, 3.94), "sigma": (2.06e-5, 7.31e-1)},
    "lbfgs-zoom": {"n_d": (2.98e-6, 7.78e-5), "rho_d": (3.37e-6, 5.31e-5), "n_s": (4.45e-5, 4.34e-4),
                   "rho_s": (1.43e-5, 7.87e-5), "sigma": (2.20e-5, 3.17e-1)},
    "lbfgs-hager-zhang": {"n_d": (7.94e-6, 7.64e-5), "rho_d": (4.81e-6, 4.85e-8), "n_s": (5.79e-5, 3.29e-4),
                          "rho_s": (2.83e-5, 2.49e-6), "sigma": (9.38e-5, 5.24e-2)},
    "gd": {"n_d": (3.01e-6, 6.23e-2), "rho_d": (2.23e-6, 5.12e-4), "n_s": (2.33e-5, 2.54e-1), "rho_s": (4.31e-6, 5.13e-3),
           "sigma": (4.56e-6, 5.53e-1)},
    "ncg": {"n_d": (3.39e-5, 2.20e-4), "rho_d": (4.42e-6, 2.74e-5), "n_s": (4.77e-4, 8.72e-4), "rho_s": (6.75e-5, 1.13e-4),
            "sigma": (6.78e-5, 1.28e-3)},
    "gauss-newton": {"rho_d": (8.33e-7, 5.18e-10), "rho_s": (6.40e-6, 1.16e-8), "sigma": (5.97e-5, 2.21e-3)},
}  # fmt: skip
QUANTITIES = ("n_d", "rho_d", "n_s", "rho_s", "sigma")


@dataclass
class Cell:
    """One entry of the table: seconds a pixel, mean norm of the gradient at the end, seconds to compile."""

    seconds: float
    gradient: float
    compile_s: float = 0.0


def table_theirs(p: Pixels, solvers: tuple[str, ...]) -> dict[str, dict[str, Cell]]:
    """The solver zoo on PRF's objectives. The first run's surplus over the second is their time to compile."""
    found, starts, _ = problems(p)
    out: dict[str, dict[str, Cell]] = {}
    for solver in solvers:
        out[solver] = {}
        for quantity in QUANTITIES:
            if not applies(solver, quantity):
                continue
            problem = {k: v.astype(np.float32) for k, v in found[quantity].items()}
            start = starts[quantity].astype(np.float32)
            begin = time.perf_counter()
            solve(solver, quantity, start, problem)
            first = time.perf_counter() - begin
            begin = time.perf_counter()
            x = solve(solver, quantity, start, problem)
            seconds = time.perf_counter() - begin
            cell = Cell(seconds / len(start), gradient_norms(quantity, x, problem), first - seconds)
            out[solver][quantity] = cell
            report(solver, quantity, cell)
    return out


def report(solver: str, quantity: str, cell: Cell) -> None:
    """One line of the table."""
    print(
        f"  {solver:31} {quantity:6} {cell.seconds:.2e} s a pixel, gradient {cell.gradient:.1e}, compile {cell.compile_s:.1f}",
        flush=True,
    )


def table_ours(p: Pixels) -> dict[str, Cell]:
    """The closed forms on one thread, in float32; n_s and sigma are one joint fit (its time is given to both)."""
    found, _, light = problems(p)
    count = len(light)
    w = [np.ascontiguousarray(v) for v in p.rig.directions.T.astype(np.float32)]
    light32, use32 = light.astype(np.float32), found["n_d"]["use"].astype(np.float32)
    workspace = [np.zeros(len(w[0]), np.float32) for _ in range(2)]
    normals = np.zeros((count, 3), np.float32)

    def diffuse() -> np.ndarray:
        for k in range(count):
            normals[k] = fit_normal(light32[k], use32[k], w[0], w[1], w[2], 1, True, workspace[0], workspace[1])[:3]
        return normals

    def albedo(name: str, model: np.ndarray, kind: Any) -> Callable[[], np.ndarray]:
        data, use = (np.asarray(found[name][key], kind) for key in ("data", "use"))
        model, zero = np.ascontiguousarray(model.astype(kind)), np.zeros(len(w[0]), kind)
        return lambda: np.array([[linear_albedo(model[k], data[k], use[k], zero)] for k in range(count)], kind)

    out = {}
    seconds, x = timed(diffuse)
    out["n_d"] = Cell(seconds / count, gradient_norms("n_d", x, found["n_d"]))
    for name, model in (("rho_d", found["rho_d"]["n_d"] @ p.rig.directions.T), ("rho_s", found["rho_s"]["g"])):
        for kind, suffix in ((np.float32, ""), (np.float64, "_float64")):
            seconds, x = timed(albedo(name, model, kind))
            rounded = {k: v.astype(kind).astype(float) for k, v in found[name].items()}
            rounded["model"] = model.astype(kind).astype(float)
            out[name + suffix] = Cell(seconds / count, linear_gradient(x.astype(float), rounded))
    cross, parallel = p.cross.astype(np.float32), p.parallel.astype(np.float32)
    free = SETTINGS._replace(lobe=0, prior=0.0, mixed=0.0, robust=0)
    both, (rows, _) = timed(lambda: fit(cross, parallel, p.view, p.rig, free, threads=1))
    diffuse_only, _ = timed(lambda: fit(cross, cross, p.view, p.rig, free, threads=1))
    out["n_s"], out["sigma"] = (Cell((both - diffuse_only) / count, g) for g in joint_gradients(p, rows))
    for name, cell in out.items():
        report("ours (closed)", name, cell)
    return out


def joint_gradients(p: Pixels, rows: np.ndarray) -> tuple[float, float]:
    """Mean gradient norms by n_s (tilt) and by (log sigma, tangent) of `|rho g - I|^2 / 2|I|^2` in float64 at float32 answers.

    Independent of the kernels: numpy's Ward lobe and central differences.
    """
    w = p.rig.directions[:, None]
    light = (2 * (p.parallel - p.cross)).mean(-1) / np.pi
    normal, tangent = rows[:, AT["specular_normal"]], rows[:, AT["tangent"]]
    use = (np.sum(rows[:, AT["diffuse_normal"]] * w, -1) > 0).astype(float)  # the lights that the fit took
    h = w + p.view
    h /= np.linalg.norm(h, axis=-1, keepdims=True)
    bitangent = np.cross(normal, tangent)

    def cost(x: np.ndarray) -> np.ndarray:
        n = normal + x[0] * tangent + x[1] * bitangent
        n /= np.linalg.norm(n, axis=1, keepdims=True)
        t = np.cos(x[4]) * tangent + np.sin(x[4]) * bitangent
        t -= n * np.sum(n * t, 1, keepdims=True)
        t /= np.linalg.norm(t, axis=1, keepdims=True)
        sigma = rows[:, AT["sigma"]] * np.exp(x[2:4])
        g = ward(h, n, t, sigma, np.sum(n * p.view, 1)) * rows[:, AT["specular_albedo"]][:, 0]
        return 0.5 * np.sum(use * (g - light) ** 2, 0) / np.sum(use * light**2, 0)

    step = 1e-6
    slopes = np.stack([(cost(step * e) - cost(-step * e)) / (2 * step) for e in np.eye(5)])
    one = np.linalg.norm(tangent, axis=1) > 0.5
    return float(np.mean(np.linalg.norm(slopes[:2, one], axis=0))), float(np.mean(np.linalg.norm(slopes[2:, one], axis=0)))
