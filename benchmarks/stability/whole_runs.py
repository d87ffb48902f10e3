"""`make all` at the edge: it ends, or refuses in one line; what it writes is finite; what it cannot explain it says."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from collections.abc import Container, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from threading import Lock
from typing import Any

import numpy as np

from benchmarks.stability.extreme_scenes import SCENES, SPOILED, make
from benchmarks.stability.verdicts import Row
from pipeline.formats.images import read_exr
from pipeline.formats.ply import Ply

ROOT = Path(__file__).parents[2]
PARAMETERS = "train.iterations=200 train.max_splats=3000 relight.cube=32 metrics.mesh_samples=20000"
RENDERING = Lock()
ONE_THREAD = {"OMP_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "1"}
LIMIT_S = 1200  # of wall time: a run takes half a minute of two quiet cores
ENDS, REFUSES = "ends", "refuses"
EXPECTED = {
    "black": REFUSES, "negative": REFUSES,
    "metal": "explain", "glass ball": "explain", "mirror ball": ENDS, "three views": ENDS,
    "20 % saturated": "saturat", "1 % each of NaN, Inf, -1e30, 1e30": "finite", "8-bit sRGB photographs": "8-bit",
    "needle 1.5 pixels thick": "either", "plate seen edge-on": "either",
}  # fmt: skip
"""How a run must go if not `ENDS`: refuse, either, or end with a warning that holds this word."""


def rows(folder: Path, over: Container[str] = ()) -> Iterator[Row]:
    """A row for each case but those named in `over`, two at a time; captures and datasets lie in `folder`."""
    names = [name for name in (*SCENES, *SPOILED) if name not in over]
    with ThreadPoolExecutor(2) as pool:
        yield from pool.map(lambda name: run(folder, name), names)


def run(folder: Path, name: str) -> Row:
    """One case."""
    with RENDERING:  # one Mitsuba a program, and what is spoiled is a copy of the base
        capture = make(folder / "captures", name)
    dataset = folder / "datasets" / capture.name
    command = [sys.executable, "-m", "stages", "all", str(capture), "--dataset", str(dataset), "--params", PARAMETERS]
    environment = {**os.environ, **ONE_THREAD, "PYTHONPATH": str(ROOT)}
    try:
        done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, timeout=LIMIT_S)
    except subprocess.TimeoutExpired:
        return Row(
            part="whole runs", name=name, setting=f"{len(list((capture / 'images').iterdir()))} views",
            figures={"ended": "no"}, sound=False, why=f"has not ended after {LIMIT_S} s",
        )  # fmt: skip
    seconds = sum(float(manifest.get("cpu_s", 0.0)) for manifest in manifests(dataset))
    lines = [line for line in done.stderr.splitlines() if line.startswith("polarfield: ")]  # what refuses, and why
    warnings = told(dataset)
    expected = EXPECTED.get(name, ENDS)
    faults = [
        "a traceback" if "Traceback" in done.stderr else "",
        f"exit status {done.returncode}" if done.returncode not in (0, 2) else "",
        "refused without one line" if done.returncode == 2 and len(lines) != 1 else "",
        "should be refused" if expected == REFUSES and done.returncode == 0 else "",
        "refused" if done.returncode == 2 and expected not in (REFUSES, "either") else "",
        ""
        if expected in (ENDS, REFUSES, "either") or any(expected in w for w in warnings)
        else f"no warning says '{expected}'",
        *(f"{path} holds values that are not finite" for path in not_finite(dataset)),
    ]
    figures = scored(dataset)
    return Row(
        part="whole runs", name=name, setting=f"{len(list((capture / 'images').iterdir()))} views",
        figures={"ended": "refused" if done.returncode == 2 else "finished", **figures, "cpu_s": seconds},
        sound=not any(faults), why="; ".join(f for f in faults if f), worst=lines[-1] if lines else "", warnings=warnings,
    )  # fmt: skip


def told(dataset: Path) -> list[str]:
    """Every warning of the current versions, without the folder that it may begin with."""
    lines = [str(line) for manifest in manifests(dataset) for line in manifest.get("warnings", [])]
    return [re.sub(r"^/\S*/", "", line) for line in lines]


def manifests(dataset: Path) -> list[dict[str, Any]]:
    """Of the current versions of every stage."""
    return [json.loads(p.read_text()) for p in sorted(dataset.glob("*/current/manifest.json"))]


def scored(dataset: Path) -> dict[str, float | int | str]:
    """Likeness to unseen views, where metrics has it."""
    path = dataset / "metrics" / "current" / "metrics.json"
    if not path.is_file():
        return {}
    train = json.loads(path.read_text()).get("train", {})
    return {k: train[k] for k in ("psnr_foreground", "likeness") if isinstance(train.get(k), int | float)}


def not_finite(dataset: Path) -> list[Path]:
    """Images and splats of the current versions that hold a value that is not finite."""
    bad = []
    for path in sorted(dataset.glob("*/current/**/*")):
        if path.suffix == ".exr" and not all(np.isfinite(x).all() for x in read_exr(path).values()):
            bad.append(path.relative_to(dataset))
        if path.suffix == ".ply" and not all(np.isfinite(x).all() for x in Ply(path).elements["vertex"].columns.values()):
            bad.append(path.relative_to(dataset))
    return bad
