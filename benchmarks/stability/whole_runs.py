"""`make all` at the edge: it ends, or refuses in one line; what it writes is finite; what is wrong or not explained it says."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Container, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from threading import Lock
from typing import Any

import numpy as np

from benchmarks.stability.extreme_scenes import PIXEL_PCT, SCENES, SPOILED, make
from benchmarks.stability.surface_truth import seen_error_pct
from benchmarks.stability.verdicts import Row
from pipeline.formats.images import read_exr
from pipeline.formats.ply import Ply

ROOT = Path(__file__).parents[2]
PARAMETERS = "train.iterations=200 train.max_splats=3000 relight.cube=32 metrics.mesh_samples=20000"
RENDERING = Lock()
ONE_THREAD = {"OMP_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "1"}
LIMIT_S = 1200  # of wall time: a run takes half a minute of two quiet cores
FOLDER = re.compile(r"(?<!\S)/\S*/")  # that a path begins with: it tells nothing of the case
ENDS, REFUSES = "ends", "refuses"
EXPECTED = {
    "black": REFUSES, "negative": REFUSES,
    "metal": "explain", "glass ball": "explain", "mirror ball": ENDS, "three views": ENDS,
    "20 % saturated": "saturat", "1 % each of NaN, Inf, -1e30, 1e30": "finite", "8-bit sRGB photographs": "8 bits",
    "radiance x 1e-30": "precision",
    "needle 1.5 pixels thick": "either", "plate seen edge-on": "either",
}  # fmt: skip
"""How a run must go if not `ENDS`: refuse, either, or end with a warning that holds this word."""
SAME = ("radiance x 1e30", "world x 1e-3", "world x 1e4", "world shifted by 1e5 of its size")
"""Cases that are the base capture in other units: they must find what it finds."""
SAME_AS = {"surface_pct": 0.2, "likeness": 0.02}  # a tenth of a pixel, and more than another order of sums changes
DOUBTS = ("explain", "hull", "one side", "seen by no view", "mask", "saturat", "not finite")
"""Words of warnings that tell of a shape or of pictures that may be wrong; others (of files, of units) excuse nothing."""
TWICE_DB = 6.0  # below the base's PSNR: twice its error


@dataclass(frozen=True)
class Ended:
    """How a case went: exit status (None: it did not end), what it wrote to stderr, its warnings, figures and faulty files."""

    status: int | None
    errors: str
    warnings: list[str]
    figures: dict[str, float | int | str]
    bad_files: list[str]


def rows(folder: Path, over: Container[str] = ()) -> Iterator[Row]:
    """A row for each case but those named in `over`, two at a time; captures and datasets lie in `folder`."""
    names = [name for name in (*SCENES, *SPOILED) if name not in over]
    with ThreadPoolExecutor(2) as pool:
        for name, ended in zip(names, pool.map(lambda name: run(folder, name), names)):  # base is the first that ever runs
            views = len(list((make(folder / "captures", name) / "images").iterdir()))
            yield row(name, f"{views} views", ended, scored(folder, "base"))


def run(folder: Path, name: str) -> Ended:
    """One case."""
    with RENDERING:  # one Mitsuba a program, and what is spoiled is a copy of the base
        capture = make(folder / "captures", name)
    dataset = folder / "datasets" / capture.name
    shutil.rmtree(dataset, ignore_errors=True)  # what an earlier commit made is not judged
    command = [sys.executable, "-m", "stages", "all", str(capture), "--dataset", str(dataset), "--params", PARAMETERS]
    environment = {**os.environ, **ONE_THREAD, "PYTHONPATH": str(ROOT)}
    status: int | None = None
    errors = ""
    try:
        done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, timeout=LIMIT_S)
        status, errors = done.returncode, done.stderr
    except subprocess.TimeoutExpired:
        pass
    seconds = sum(float(manifest.get("cpu_s", 0.0)) for manifest in manifests(dataset))
    return Ended(status, errors, told(dataset), {**scored(folder, name), "cpu_s": seconds}, not_finite(dataset))


def row(name: str, setting: str, ended: Ended, base: Mapping[str, float]) -> Row:
    """The verdict on a case; `base`: figures of the base capture's run."""
    said = [line for line in ended.errors.splitlines() if line.startswith("polarfield: ")]  # what refuses, and why
    lines = [FOLDER.sub("", line) for line in said]
    expected = EXPECTED.get(name, ENDS)
    refused = ended.status == 2
    word = "" if expected in (ENDS, REFUSES, "either") else expected
    faults = [
        f"has not ended after {LIMIT_S} s" if ended.status is None else "",
        "a traceback" if "Traceback" in ended.errors else "",
        f"exit status {ended.status}" if ended.status not in (0, 2, None) else "",
        "refused without one line" if refused and len(lines) != 1 else "",
        "should be refused" if expected == REFUSES and ended.status == 0 else "",
        "refused" if refused and expected not in (REFUSES, "either") else "",
        f"no warning says '{word}'" if word and not any(word in w for w in ended.warnings) else "",
        *(f"{path} holds values that are not finite" for path in ended.bad_files),
        *(unlike(ended.figures, base) if name in SAME and ended.status == 0 else []),
        *(f"{fault} without a word" for fault in wrong(ended.figures, base) if not doubted(ended.warnings)),
    ]
    how = {0: "finished", 2: "refused", None: "no"}.get(ended.status, "failed")
    return Row(
        part="whole runs", name=name, setting=setting, figures={"ended": how, **ended.figures}, sound=not any(faults),
        why="; ".join(f for f in faults if f), worst=lines[-1] if lines else "", warnings=ended.warnings,
    )  # fmt: skip


def doubted(warnings: Sequence[str]) -> bool:
    """Whether some warning tells that the result may be wrong."""
    return any(word in line for line in warnings for word in DOUBTS)


def wrong(figures: Mapping[str, Any], base: Mapping[str, float]) -> list[str]:
    """What of a finished run is wrong: the seen surface more than a pixel off, or unseen views at twice the base's error."""
    off, psnr = figures.get("surface_pct", 0.0), figures.get("psnr_foreground", np.inf)
    return [
        *([f"the surface is {off:.1f} % of its size off (a pixel is {PIXEL_PCT:.1f} %)"] if off > PIXEL_PCT else []),
        *([f"unseen views have {psnr:.1f} dB"] if psnr < base.get("psnr_foreground", -np.inf) - TWICE_DB else []),
    ]


def unlike(figures: Mapping[str, Any], base: Mapping[str, float]) -> list[str]:
    """In what a run differs from that of the base capture."""
    found = {k: float(figures.get(k, np.nan)) for k in SAME_AS}
    return [f"{k} {found[k]:.3g}, not {base[k]:.3g}" for k, most in SAME_AS.items() if not abs(found[k] - base[k]) <= most]


def told(dataset: Path) -> list[str]:
    """Every warning of the current versions, without the folder that it may begin with."""
    lines = [str(line) for manifest in manifests(dataset) for line in manifest.get("warnings", [])]
    return [FOLDER.sub("", line) for line in lines]


def manifests(dataset: Path) -> list[dict[str, Any]]:
    """Of the current versions of every stage."""
    return [json.loads(p.read_text()) for p in sorted(dataset.glob("*/current/manifest.json"))]


def scored(folder: Path, name: str) -> dict[str, float]:
    """Likeness to unseen views, where metrics has it, and the surface's distance from the true one, of a case that has run."""
    capture = make(folder / "captures", name)
    dataset = folder / "datasets" / capture.name
    path, mesh = (dataset / stage / "current" / file for stage, file in (("metrics", "metrics.json"), ("mesh", "mesh.ply")))
    train = json.loads(path.read_text()).get("train", {}) if path.is_file() else {}
    figures = {k: float(train[k]) for k in ("psnr_foreground", "likeness") if isinstance(train.get(k), int | float)}
    return figures | ({"surface_pct": seen_error_pct(capture, name, mesh)} if mesh.is_file() else {})


def not_finite(dataset: Path) -> list[str]:
    """Images and splats of the current versions that hold a value that is not finite."""
    bad = []
    for path in sorted(dataset.glob("*/current/**/*")):
        if path.suffix == ".exr" and not all(np.isfinite(x).all() for x in read_exr(path).values()):
            bad.append(str(path.relative_to(dataset)))
        if path.suffix == ".ply" and not all(np.isfinite(x).all() for x in Ply(path).elements["vertex"].columns.values()):
            bad.append(str(path.relative_to(dataset)))
    return bad
