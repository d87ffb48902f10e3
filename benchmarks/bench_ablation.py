"""The papers' own runs: PhyGaP's ablation (Table 2: polarisation x GridMap), its weights (Fig. 14), and this program beside it.

    python -m benchmarks.bench_ablation --captures DIR [--out DIR] [--only NAME ...] [--rows NAME ...] [--steps N]

DIR holds captures with `gt/`, `gt/relight/` and the maps (or the environment variable POLARFIELD_CAPTURES). A row is a whole
run of the program, from photographs to relit views and metrics, with `train.preset=paper` and what the row changes; "ours" are
the defaults. As in the paper, "no polarisation" is lambda 1 = 0. Figures are those of metrics.json, means over the relit maps.
Writes ablation.json after every row, and ablation.png; rows that are there already are kept, if made with today's parameters.
--steps: fewer than the default, which the file says (`parameters.iterations` of every row).
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import subprocess
import sys
import time
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.engine.stage import parameters_from
from stages.train.parameters import PAPER
from stages.train.stage import STAGE

CAPTURES = ("teapot-lebombo", "spot-venice")
PRINTED = {"weight_polarisation": "1", "weight_mask": "2", "weight_depth_normal": "3", "weight_smooth": "4"}
"""Lambdas by the name of their parameter."""
FACTORS = (0.2, 0.5, 2.0, 5.0)  # of a lambda, around what the paper reports
RELIT = ("psnr_srgb", "psnr_srgb_scaled", "psnr_foreground", "ssim", "lpips", "flip")
ENVIRONMENT = ("env_psnr", "env_psnr_scaled", "env_log_correlation")
VIEWS = ("psnr_srgb", "psnr_foreground", "normal_mae_deg", "normal_cosine_distance", "dolp_mae", "ior_error", "roughness_error")


def table_2() -> dict[str, dict[str, Any]]:
    """The four rows of the paper's ablation and this program, as train parameters by name."""
    paper = {"preset": "paper"}
    no_pol, no_grid = {"weight_polarisation": 0.0}, {"indirect": "none"}
    return {
        "no polarisation, no GridMap": paper | no_pol | no_grid,
        "no polarisation": paper | no_pol,
        "no GridMap": paper | no_grid,
        "paper": paper,
        "ours": {},
    }


def figure_14() -> dict[str, dict[str, Any]]:
    """One lambda changed at a time."""
    out = {}
    for parameter, number in PRINTED.items():
        for factor in FACTORS:
            out[f"lambda {number} x {factor:g}"] = {"preset": "paper", parameter: round(factor * PAPER[parameter], 6)}
    return out


def rows(steps: int) -> dict[str, dict[str, Any]]:
    """Every row's train parameters by name, in the order they are run."""
    fixed = {"iterations": steps} if steps else {}
    return {name: given | fixed for name, given in (table_2() | figure_14()).items()}


def all_parameters(given: dict[str, Any]) -> dict[str, Any]:
    """Every train parameter of a row."""
    return asdict(parameters_from(STAGE, {k: str(v) for k, v in given.items()}, "bench_ablation"))


def run_row(folder: Path, dataset: Path, given: dict[str, Any]) -> dict[str, Any]:
    """The figures of one run of the whole program, and its processor seconds."""
    params = " ".join(f"train.{k}={v}" for k, v in given.items())
    command = [sys.executable, "-m", "stages", "all", str(folder), "--dataset", str(dataset), "--params", params]
    before = os.times()
    done = subprocess.run(command, capture_output=True, text=True)
    if done.returncode:
        raise RuntimeError(f"{' '.join(command)}: {done.stderr[-2000:]}")
    spent = os.times()
    seconds = spent.children_user + spent.children_system - before.children_user - before.children_system
    metrics = json.loads((dataset / "metrics" / "current" / "metrics.json").read_text())
    relit = [part for part in metrics["relight"].values() if isinstance(part, dict) and "views" in part]
    train = metrics["train"]
    return {
        "parameters": all_parameters(given),
        "given": given,
        "processor_s": round(seconds, 1),
        "views": {k: train.get(k) for k in VIEWS},
        "environment": {k: train.get(k) for k in ENVIRONMENT},
        "relit": {k: mean([part.get(k) for part in relit]) for k in RELIT},
    }


def mean(values: list[float | None]) -> float | None:
    """Mean of what is known; None where nothing is."""
    known = [v for v in values if v is not None]
    return float(np.mean(known)) if known else None


def plot(captures: dict[str, Any], path: Path) -> None:
    """One row a capture: the figures of Table 2 as bars, and cosine distance and PSNR over each lambda (Fig. 14)."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(len(captures), 4, figsize=(18, 4 * len(captures)), squeeze=False)
    bars = (("environment", "env_psnr"), ("relit", "psnr_srgb"), ("views", "psnr_srgb"))
    for row, (capture, found) in zip(axes, captures.items()):
        for axis, (part, name) in zip(row, bars):
            there = {n: found[n][part][name] for n in table_2() if n in found and found[n][part][name] is not None}
            axis.barh(list(there)[::-1], list(there.values())[::-1])
            axis.set(title=f"{capture}: {part} {name} (dB)")
        for parameter, number in PRINTED.items():
            swept = {f: found[n] for f in FACTORS if (n := f"lambda {number} x {f:g}") in found}
            if "paper" in found and swept:
                points = sorted((swept | {1.0: found["paper"]}).items())
                row[3].plot([f for f, _ in points], [r["views"]["normal_mae_deg"] for _, r in points], "o-", label=parameter)
        row[3].set(title=f"{capture}: normals (deg) over lambda / reported", xscale="log")
        if row[3].lines:
            row[3].legend(fontsize=7)
    figure.tight_layout()
    figure.savefig(path, dpi=90)
    pyplot.close(figure)


def main() -> None:
    """Run what is not there yet, writing after each row."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--captures", type=Path, default=os.environ.get("POLARFIELD_CAPTURES"))
    parser.add_argument("--out", type=Path, default=Path("build/bench"))
    parser.add_argument("--only", nargs="*", default=list(CAPTURES), help="capture names")
    parser.add_argument("--rows", nargs="*", default=[], help="names of rows; those of Table 2 and Fig. 14 if none are named")
    parser.add_argument("--steps", type=int, default=0, help="training steps a row; 0 = the default")
    arguments = parser.parse_args()
    if arguments.captures is None:
        parser.error("say where the captures are: --captures DIR or POLARFIELD_CAPTURES")
    out, wanted = arguments.out, rows(arguments.steps)
    out.mkdir(parents=True, exist_ok=True)
    path = out / "ablation.json"
    machine = {"cpu": platform.processor() or platform.machine(), "cores": os.cpu_count()}
    results: dict[str, Any] = {"machine": machine, "captures": {}}
    if path.exists():
        results["captures"] = json.loads(path.read_text())["captures"]
    for name in arguments.only:
        found = results["captures"].setdefault(name, {})
        for row, given in wanted.items():
            if (arguments.rows and row not in arguments.rows) or found.get(row, {}).get("parameters") == all_parameters(given):
                continue
            started = time.monotonic()
            found[row] = run_row(Path(arguments.captures) / name, out / "ablation" / name, given)
            print(f"{name}: {row} ({time.monotonic() - started:.0f} s)", {k: found[row][k] for k in ("environment", "relit")})
            path.write_text(json.dumps(results, indent=1) + "\n")
    if results["captures"]:
        plot(results["captures"], out / "ablation.png")


if __name__ == "__main__":
    main()
