"""The same bytes twice: two runs, one thread and two, one job and two."""

from __future__ import annotations

import hashlib
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path

from benchmarks.stability.processor_time import spent
from benchmarks.stability.verdicts import Row

ROOT = Path(__file__).parents[2]
TRAINED = "train.iterations=40 train.max_splats=3000"
SECONDS = {"train_log.csv"}  # it holds times
CLOSE = {"one thread"}
"""Runs whose sums are added in another order: the stages up to masks and olat must repeat, training need not."""
EXACT = ("decode", "poses", "masks", "olat")


def rows(captures: Path, datasets: Path) -> Iterator[Row]:
    """Views (to train) and a light stage (to olat), each under every condition; captures holds `views` and `stage`."""
    for capture, until in (("views", "train"), ("stage", "olat")):
        first = _digests(captures / capture, datasets / f"{capture}-first", until, {}, 1)[0]
        for name, environment, jobs in (
            ("again", {}, 1),
            ("one thread", {"NUMBA_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}, 1),
            ("two jobs", {}, 2),
        ):
            found, seconds = _digests(
                captures / capture, datasets / f"{capture}-{name.replace(' ', '-')}", until, environment, jobs
            )
            other, bad = differing(first, found, name)
            yield Row(
                part="repeats", name=f"{capture} to {until}", setting=name,
                figures={"files": len(first), "different": len(other), "cpu_s": seconds}, sound=bool(first) and not bad,
                why=", ".join(bad[:3]), worst=", ".join(other[:2]),
            )  # fmt: skip


def differing(first: Mapping[str, str], found: Mapping[str, str], name: str) -> tuple[list[str], list[str]]:
    """Files (STAGE/...) whose digests differ from the first run's, or that one run has alone, and those that must not."""
    other = sorted(k for k in {*first, *found} if first.get(k) != found.get(k))
    return other, [k for k in other if name not in CLOSE or k.split("/")[0] in EXACT]


def _digests(
    capture: Path, dataset: Path, until: str, environment: Mapping[str, str], jobs: int
) -> tuple[dict[str, str], float]:
    shutil.rmtree(dataset, ignore_errors=True)
    start = spent()
    done = subprocess.run(
        [sys.executable, "-m", "stages", until, capture, "--dataset", dataset, "--params", TRAINED, "--jobs", str(jobs)],
        cwd=ROOT, env={**os.environ, "PYTHONPATH": str(ROOT), **environment}, capture_output=True, text=True,
    )  # fmt: skip
    if done.returncode:
        raise RuntimeError(f"{capture}: {done.stderr.strip().splitlines()[-1]}")
    found = {}
    for path in sorted(dataset.glob("*/current/**/*")):
        stage, _, *inside = path.relative_to(dataset).parts
        if path.is_file() and path.name not in {"manifest.json", *SECONDS}:
            found["/".join((stage, *inside))] = hashlib.sha256(path.read_bytes()).hexdigest()
    return found, spent() - start
