"""The tiny captures, rendered once into the build folder, and the command run on them."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
CACHE = ROOT / "build" / "tests" / "captures-64-1"  # size and edition: raise the edition when synth changes its output
QUICK = (
    "train.iterations=80 train.max_splats=2500 train.hull_resolution=64 train.checkpoint_s=1 "
    "relight.cube=32 metrics.mesh_samples=20000"
)


@dataclass(frozen=True)
class Outcome:
    """What a command left: exit status, output, seconds."""

    status: int
    out: str
    err: str
    seconds: float


def command(*arguments: object) -> list[str]:
    """The polarfield command of this checkout."""
    return [sys.executable, "-m", "stages", *map(str, arguments)]


def polarfield(*arguments: object, timeout: float = 600) -> Outcome:
    """Run polarfield to its end."""
    started = time.monotonic()
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    done = subprocess.run(command(*arguments), capture_output=True, text=True, timeout=timeout, env=environment, cwd=ROOT)
    return Outcome(done.returncode, done.stdout, done.stderr, time.monotonic() - started)


@pytest.fixture(scope="session")
def captures() -> Path:
    """Folder with views/ (16 of 64x64) and stage/ (24 lights)."""
    pytest.importorskip("mitsuba")
    size = ["--size", "64", "--spp", "48", "--lights", "24"]
    subprocess.run([sys.executable, "-m", "synth", str(CACHE), *size], check=True, cwd=ROOT, timeout=600)
    return CACHE


@pytest.fixture(scope="session")
def views_dataset(captures, tmp_path_factory) -> Path:
    """The multi-view capture through every stage, with a very short training."""
    root = tmp_path_factory.mktemp("whole") / "views"
    outcome = polarfield("all", captures / "views", "--dataset", root, "--params", QUICK)
    assert outcome.status == 0, outcome.err
    return root


@pytest.fixture(scope="session")
def stage_dataset(captures, tmp_path_factory) -> Path:
    """The light stage through every stage."""
    root = tmp_path_factory.mktemp("whole") / "stage"
    outcome = polarfield("all", captures / "stage", "--dataset", root)
    assert outcome.status == 0, outcome.err
    return root
