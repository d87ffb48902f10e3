"""kill -9 at any moment, then the same command again: the same result as without."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import time
from pathlib import Path

import numpy as np
import pytest

from .conftest import QUICK, ROOT, command, polarfield

pytestmark = pytest.mark.slow
ROUNDS = 4
EXACT = ("decode", "poses", "masks")  # bit for bit; the others to equal figures


def digests(root: Path, stage: str) -> dict[str, str]:
    manifest = json.loads((root / stage / "current" / "manifest.json").read_text())
    return {o["path"]: o["digest"] for o in manifest["outputs"]}


def kill_after(seconds: float, arguments: list[str]) -> bool:
    """Start the command in a session of its own and kill that; whether it was still running."""
    child = subprocess.Popen(arguments, cwd=ROOT, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True)
    try:
        child.wait(timeout=seconds)
        return False
    except subprocess.TimeoutExpired:
        os.killpg(child.pid, signal.SIGKILL)
        child.wait()
        return True


def test_killed_at_random_moments_it_ends_as_if_never_killed(captures, views_dataset, tmp_path):
    root = tmp_path / "killed"
    arguments = ["all", captures / "views", "--dataset", root, "--params", QUICK]
    rng = np.random.default_rng(11)
    kills = sum(kill_after(float(rng.uniform(0.3, 8.0)), command(*arguments)) for _ in range(ROUNDS))
    assert kills >= ROUNDS // 2
    for stage in (p for p in root.glob("[a-z]*") if p.is_dir()):  # whatever is published is whole
        for version in (p for p in stage.iterdir() if p.is_dir() and not p.is_symlink()):
            manifest = json.loads((version / "manifest.json").read_text())
            assert all((version / o["path"]).stat().st_size == o["bytes"] for o in manifest["outputs"])
    finished = polarfield(*arguments)
    assert finished.status == 0, finished.err
    for stage in EXACT:
        assert digests(root, stage) == digests(views_dataset, stage)
    ours, theirs = (json.loads((r / "metrics/current/metrics.json").read_text()) for r in (root, views_dataset))
    assert ours["train"]["psnr_srgb"] == pytest.approx(theirs["train"]["psnr_srgb"], abs=0.3)
    assert ours["mesh"]["chamfer_pct"] == pytest.approx(theirs["mesh"]["chamfer_pct"], abs=0.2)
    assert not list((root / ".work").glob("*/*/output"))


def test_two_runs_at_once_do_not_disturb_each_other(captures, tmp_path):
    root = tmp_path / "shared"
    arguments = command("masks", captures / "views", "--dataset", root)
    both = [subprocess.Popen(arguments, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) for _ in range(2)]
    deadline = time.monotonic() + 120
    for run in both:
        _, error = run.communicate(timeout=deadline - time.monotonic())
        assert run.returncode == 0, error
    assert len([p for p in (root / "masks").iterdir() if p.is_dir() and not p.is_symlink()]) == 1
