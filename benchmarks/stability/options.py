"""Every option of the light stage, run from frames to maps and relit: it ends, finite, not black, under the lobe it fitted."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from importlib.util import find_spec
from pathlib import Path
from typing import get_args, get_type_hints

import numpy as np

from benchmarks.stability.verdicts import Row
from pipeline.capture import open_capture
from pipeline.formats.dataset_files import FITTED_LOBE
from pipeline.formats.images import read_exr
from pipeline.rig.relighting import relight_maps
from stages.olat.parameters import OlatParameters
from stages.olat.zoo.solvers import SOLVERS, library

ROOT = Path(__file__).parents[2]
LANES = 2  # settings at a time, each lane in a dataset of its own
ONE_THREAD = {"OMP_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "1"}
BRIGHTER = 4.0
"""How much brighter than under the default the brightest of a thousand pixels may be relit: fireflies are a hundred times."""
DIM = 0.5  # of the default's mean radiance, relit: what is below it has lost a part of the light


def settings() -> list[dict[str, str]]:
    """The default, then every other value of every option that has a list of them, one at a time, but for solvers of packages
    that are not installed."""
    out: list[dict[str, str]] = [{}]
    hints = get_type_hints(OlatParameters)
    for name, default in vars(OlatParameters()).items():
        values = ("true", "false") if isinstance(default, bool) else get_args(hints[name])
        out += [{name: str(value)} for value in values if str(value).lower() != str(default).lower()]
    out = [options for options in out if options.get("solver") not in SOLVERS or find_spec(library(options["solver"]))]
    return [*out, {"lights": "every=2"}, {"overexposure": "remove", "overexposure_gap": "0.05", "overexposure_rounds": "3"}]


def rows(capture: Path, dataset: Path) -> Iterator[Row]:
    """A row for each setting, two at a time; `capture` is a light stage, `dataset` names where runs go."""
    for lane in dataset.parent.glob(f"{dataset.name}*"):
        shutil.rmtree(lane)  # what an earlier commit made is not judged
    first, *others = settings()
    row, standard = _row(capture, dataset, first, None)
    yield row
    lanes = [(others[k::LANES], dataset.with_name(f"{dataset.name}-{k}")) for k in range(LANES)]
    with ThreadPoolExecutor(LANES) as pool:
        for found in pool.map(lambda lane: [_row(capture, lane[1], options, standard)[0] for options in lane[0]], lanes):
            yield from found


def _row(
    capture: Path, dataset: Path, options: dict[str, str], standard: tuple[float, float] | None
) -> tuple[Row, tuple[float, float] | None]:
    """One setting, and the mean and the peak of its relit radiance; standard: the default's."""
    given = " ".join(f"olat.{name}={value}" for name, value in options.items())
    done = subprocess.run(
        [sys.executable, "-m", "stages", "olat", capture, "--dataset", dataset, "--params", given],
        cwd=ROOT, env={**os.environ, **ONE_THREAD, "PYTHONPATH": str(ROOT)}, capture_output=True, text=True,
    )  # fmt: skip
    name = ", ".join(f"{k}={v}" for k, v in options.items()) or "default"
    if done.returncode:
        last = (done.stderr.strip().splitlines() or ["no word"])[-1]
        return Row("options", "olat", name, {}, False, why=last), None
    output = dataset / "olat" / "current"
    lobe = json.loads((output / FITTED_LOBE).read_text())["lobe"]
    bad = [p.name for p in sorted(output.rglob("*.exr")) if not all(np.isfinite(c).all() for c in read_exr(p).values())]
    mean, peak = relit(capture, output)
    wanted = options.get("lobe", "ward" if options.get("solver", "closed") != "closed" else lobe)
    faulty = faults(bad, (mean, peak), standard or (mean, peak), lobe, wanted)
    seconds = float(json.loads((output / "manifest.json").read_text())["cpu_s"])
    figures: dict[str, float | int | str] = {"lobe": lobe, "relit_mean": mean, "relit_peak": peak, "cpu_s": seconds}
    why = "; ".join(faulty)
    return Row("options", "olat", name, figures, not why, why=why), (mean, peak)


def faults(bad: Sequence[str], found: tuple[float, float], standard: tuple[float, float], lobe: str, wanted: str) -> list[str]:
    """What is wrong with a setting: files that are not finite, mean and peak of its relit radiance beside the default's, and
    the lobe that `maps.json` names beside the one that was to be fitted."""
    (mean, peak), (mean_of, peak_of) = found, (max(x, 1e-30) for x in standard)
    said = {
        f"{', '.join(bad[:3])} not finite": bool(bad),
        "relit black": not mean > 0,
        f"relit at {mean / mean_of:.2f} of the default": 0 < mean < DIM * mean_of,
        f"a relit peak {peak / peak_of:.0f} times the default's": peak > BRIGHTER * peak_of,
        f"maps.json says {lobe}": lobe != wanted,
    }
    return [fault for fault, there in said.items() if there]


def relit(capture: Path, output: Path) -> tuple[float, float]:
    """Mean and 99.9th percentile of the radiance of a stage's first camera under a sky with one bright spot."""
    stage = open_capture(capture).light_stage
    assert stage is not None
    name = sorted(stage.cameras)[0]
    sky = np.full((16, 32, 3), 0.2)
    sky[4, 16] = 50.0
    image = relight_maps(output / name, stage.cameras[name].camera, sky)
    lit = image.reshape(-1, 3).mean(1)
    lit = lit[lit > 0]
    return (float(lit.mean()), float(np.quantile(lit, 0.999))) if lit.size else (0.0, 0.0)
