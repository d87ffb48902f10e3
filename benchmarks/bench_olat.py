"""Speed and error of the olat fits: the whole chain, PRF's Table 3 rerun, errors against the number of lights.

`make bench-olat [CAPTURES=folder]`; CAPTURES adds the captures with ground truth found there (options, errors). Results go to
benchmarks/results/olat.json and plots beside it.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.olat_pixels import Pixels, angle_deg, make, rig_of
from pipeline.lights.solid_angles import solid_angles
from pipeline.lights.tables import table_from_positions
from stages.olat.columns import FLAG, columns
from stages.olat.diffuse import fit_normal
from stages.olat.fit import fit
from stages.olat.lobe_fit import linear_albedo
from stages.olat.run import GAIN, MIXED, PRIOR
from stages.olat.workspace import Settings
from stages.olat.zoo import SOLVERS, applies, scaled, solve

RESULTS = Path(__file__).parent / "results"
AT = columns()
SETTINGS = Settings(
    lobe=0, rounds=8, robust=2, steps=15, tolerance=3e-6, saturation=np.inf, specular_factor=2.0, irradiance=np.pi, gain=GAIN,
    mixed=MIXED, prior=PRIOR, plain=False, specular_fit=0, fuse_correlation=False,
    printed_maps=False, remove=False, gradient=False,
)  # fmt: skip
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
    """One entry of the table: seconds a pixel and the mean norm of the gradient at the end."""

    seconds: float
    gradient: float


def timed(work: Callable[[], Any], repeats: int = 3) -> tuple[float, Any]:
    """Median wall time and the result, after one run to compile."""
    work()
    times, out = [], None
    for _ in range(repeats):
        start = time.perf_counter()
        out = work()
        times.append(time.perf_counter() - start)
    return float(np.median(times)), out


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


def objective(quantity: str, x: np.ndarray, p: dict[str, np.ndarray]) -> float:
    """PRF's objectives in float64 numpy (the independent twin of stages.olat.objectives)."""
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


def problems(p: Pixels) -> tuple[dict[str, dict[str, np.ndarray]], dict[str, np.ndarray], np.ndarray]:
    """PRF's five problems for these pixels at the true normals' active sets, their starts, and the diffuse samples."""
    w = p.rig.directions
    light = 2 * p.cross.mean(-1).T
    shine = (2 * (p.parallel - p.cross)).mean(-1).T / np.pi
    use = (p.normal @ w.T > 0).astype(float)
    data_d, data_s = scaled(light, use)[0], scaled(shine, use)[0]
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


def table_theirs(p: Pixels, solvers: tuple[str, ...]) -> dict[str, dict[str, Cell]]:
    """jaxopt's solvers on PRF's objectives."""
    found, starts, _ = problems(p)
    out: dict[str, dict[str, Cell]] = {}
    for solver in solvers:
        out[solver] = {}
        for quantity in QUANTITIES:
            if not applies(solver, quantity):
                continue
            problem = {k: v.astype(np.float32) for k, v in found[quantity].items()}
            start = starts[quantity].astype(np.float32)
            seconds, x = timed(lambda s=solver, q=quantity, a=start, b=problem: solve(s, q, a, b), 1)  # type: ignore[misc]
            out[solver][quantity] = Cell(seconds / len(start), gradient_norms(quantity, x, problem))
            print(
                f"  {solver:20} {quantity:6} {out[solver][quantity].seconds:.2e} s  {out[solver][quantity].gradient:.1e}",
                flush=True,
            )
    return out


def table_ours(p: Pixels) -> dict[str, Cell]:
    """The closed forms, quantity by quantity, on one thread; n_s and sigma are the joint fit's (its time is shared by both)."""
    found, _, light = problems(p)
    count = len(light)
    w = [np.ascontiguousarray(v) for v in p.rig.directions.T.astype(np.float32)]
    light32, use32 = light.astype(np.float32), found["n_d"]["use"].astype(np.float32)
    room = [np.zeros(len(w[0]), np.float32) for _ in range(3)]
    normals = np.zeros((count, 3), np.float32)

    def diffuse() -> np.ndarray:
        for k in range(count):
            normals[k] = fit_normal(light32[k], use32[k], *w, 1, True, *room)[:3]
        return normals

    def albedo(name: str, model: np.ndarray) -> Callable[[], np.ndarray]:
        data, use = found[name]["data"].astype(np.float32), found[name]["use"].astype(np.float32)
        model, zero = np.ascontiguousarray(model.astype(np.float32)), np.zeros(len(w[0]), np.float32)
        return lambda: np.float32([[linear_albedo(model[k], data[k], use[k], zero)] for k in range(count)])

    out = {}
    seconds, x = timed(diffuse)
    out["n_d"] = Cell(seconds / count, gradient_norms("n_d", x, found["n_d"]))
    for name, model in (("rho_d", found["rho_d"]["n_d"] @ p.rig.directions.T), ("rho_s", found["rho_s"]["g"])):
        seconds, x = timed(albedo(name, model))
        rounded = {k: v.astype(np.float32) for k, v in found[name].items()}
        out[name] = Cell(seconds / count, gradient_norms(name, x, rounded))
    cross, parallel = p.cross.astype(np.float32), p.parallel.astype(np.float32)
    free = SETTINGS._replace(prior=0.0, mixed=0.0)
    both, (_, norms) = timed(lambda: fit(cross, parallel, p.view, p.rig, free, threads=1))
    diffuse_only, _ = timed(lambda: fit(cross, cross, p.view, p.rig, free, threads=1))
    fitted = norms[:, 1] > 0
    joint = Cell((both - diffuse_only) / count, float(np.mean(norms[fitted, 0])))
    out["n_s"] = out["sigma"] = joint
    return out


def throughput(count: int, lights: int = 346) -> dict[str, float]:
    """The whole chain on RGB pixels in memory (half floats), all threads: pixels a second."""
    p = make(count, rig=rig_of(lights), sigma=None, noise=5e-4, shadow=0.3, lobe="beckmann")
    half = [np.ascontiguousarray(x.astype(np.float16)).view(np.uint16) for x in (p.cross, p.parallel)]
    seconds, _ = timed(lambda: fit(*half, p.view, p.rig, SETTINGS))
    start = time.process_time()
    fit(*half, p.view, p.rig, SETTINGS)
    cpu = time.process_time() - start
    return {
        "pixels": count, "lights": lights, "threads": os.cpu_count() or 1, "pixels_per_s": count / seconds,
        "pixels_per_cpu_s": count / cpu, "peak_rss_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
    }  # fmt: skip


def against_lights(steps: tuple[int, ...] = (1, 2, 4, 8, 16, 32)) -> list[dict[str, float]]:
    """Median errors with each k-th light of 346."""
    out = []
    for step in steps:
        rig = table_from_positions(rig_of().positions[::step])
        rig = type(rig)(rig.directions, rig.positions, rig.intensity, solid_angles(rig.directions))
        p = make(800, rig=rig, sigma=(0.3, 0.2), noise=1e-3, shadow=0.3)
        rows, _ = fit(p.cross.astype(np.float32), p.parallel.astype(np.float32), p.view, p.rig, SETTINGS)
        row = {"lights": len(rig), "flagged": float(np.mean(rows[:, FLAG] != 0))}
        for name, key in (("n_d", "diffuse_normal"), ("n_s", "specular_normal")):
            row[f"{name}_deg"] = float(np.median(angle_deg(rows[:, AT[key]], p.normal)))
        row["sigma_rel"] = float(np.median(np.abs(rows[:, AT["sigma"]] / p.sigma - 1)))
        row["rho_d_rel"] = float(np.median(np.abs(rows[:, AT["diffuse_albedo"]] / p.albedo - 1)))
        out.append(row)
        print("  " + "  ".join(f"{k} {v:.3g}" for k, v in row.items()), flush=True)
    return out


def plot(ours: dict[str, Cell], theirs: dict[str, dict[str, Cell]], lights: list[dict[str, float]]) -> None:
    """Run time against gradient norm, and errors against lights."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(1, 5, figsize=(20, 4.2), sharey=True)
    for axis, quantity in zip(axes, QUANTITIES):
        rows = {"ours (closed)": ours[quantity], **{s: c[quantity] for s, c in theirs.items() if quantity in c}}
        for name, cell in rows.items():
            axis.loglog(
                cell.seconds,
                max(cell.gradient, 1e-12),
                "*" if "ours" in name else "o",
                ms=14 if "ours" in name else 7,
                label=name,
            )
        for solver, cells in PUBLISHED.items():
            if quantity in cells:
                axis.loglog(*cells[quantity], "x", color="0.6", label="PRF, A6000" if solver == "gd" else None)
        axis.set_title(quantity)
        axis.set_xlabel("seconds a pixel")
    axes[0].set_ylabel("gradient norm at the end")
    axes[-1].legend(fontsize=7)
    figure.tight_layout()
    figure.savefig(RESULTS / "olat_solvers.png", dpi=110)
    figure, axis = plt.subplots(figsize=(6, 4))
    for name, label in (
        ("n_d_deg", "n_d (deg)"),
        ("n_s_deg", "n_s (deg)"),
        ("sigma_rel", "sigma (rel)"),
        ("rho_d_rel", "rho_d (rel)"),
    ):
        axis.loglog([row["lights"] for row in lights], [row[name] for row in lights], "o-", label=label)
    axis.set_xlabel("lights")
    axis.set_ylabel("median error")
    axis.legend()
    figure.tight_layout()
    figure.savefig(RESULTS / "olat_lights.png", dpi=110)


def main() -> None:
    """Run everything and keep it."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--captures", type=Path, help="folder of captures with ground truth (not needed)")
    parser.add_argument("--pixels", type=int, default=4000, help="pixels of the throughput run")
    parser.add_argument("--zoo-pixels", type=int, default=64, help="pixels of the solver comparison")
    parser.add_argument("--solvers", nargs="*", default=list(SOLVERS), help="solvers to compare")
    options = parser.parse_args()
    RESULTS.mkdir(exist_ok=True)
    speed = throughput(options.pixels)
    print("whole chain: " + "  ".join(f"{k} {v:.4g}" for k, v in speed.items()), flush=True)
    pixels = make(options.zoo_pixels, sigma=(0.3, 0.2), noise=1e-3, seed=3)
    ours = table_ours(pixels)
    for quantity, cell in ours.items():
        print(f"  {'ours (closed)':20} {quantity:6} {cell.seconds:.2e} s  {cell.gradient:.1e}", flush=True)
    theirs = table_theirs(pixels, tuple(options.solvers))
    lights = against_lights()
    plot(ours, theirs, lights)
    record = {
        "speed": speed, "ours": {q: asdict(c) for q, c in ours.items()},
        "theirs": {s: {q: asdict(c) for q, c in cells.items()} for s, cells in theirs.items()},
        "published": PUBLISHED, "lights": lights,
    }  # fmt: skip
    (RESULTS / "olat.json").write_text(json.dumps(record, indent=1) + "\n")
    print(f"kept in {RESULTS}")


if __name__ == "__main__":
    main()
