"""A batch on Snakemake and as a Slurm array: killed jobs are run again, what is done is not, and one table tells all."""

from __future__ import annotations

import importlib.util
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from pipeline.formats.images import write_png

pytestmark = pytest.mark.slow
ROOT = Path(__file__).parents[2]
STAGE = """
import os, signal
from dataclasses import dataclass
from pathlib import Path
from pipeline.engine.stage import Decision, Stage
from pipeline.errors import UserError

@dataclass(frozen=True)
class Parameters:
    pass

def run(stage):
    name = stage.capture.root.name
    with open(Path(stage.capture.root.parents[1], "ran"), "a") as log:
        log.write(f"{name} NAME\\n")
    if name == "broken":
        raise UserError(stage.capture.root, "is broken", "mend it")
    if name == "killed" and not (stage.scratch / "mark").exists():
        (stage.scratch / "mark").touch()
        os.kill(os.getpid(), signal.SIGKILL)
    (stage.output / "out").write_text(name)

STAGE = Stage("NAME", 1, Parameters, NEEDS, lambda c, p: Decision(True, "always"), run)
"""
PROGRAM = """
import sys
from pipeline.engine import call, cli

PROGRAM = call.Program({"one": "house.one", "two": "house.two"}, module="house", report="two", inspect=None)
if __name__ == "__main__":
    sys.exit(cli.main(PROGRAM, sys.argv[1:]))
"""


@pytest.fixture
def lab(tmp_path):
    """`batch` of two stages over a sound capture, one that kills its first try, and one that is refused."""
    for name, needs in (("one", "()"), ("two", '("one",)')):
        (tmp_path / "house" / name).mkdir(parents=True)
        (tmp_path / "house" / name / "__init__.py").touch()
        (tmp_path / "house" / name / "stage.py").write_text(STAGE.replace("NAME", name).replace("NEEDS", needs))
    (tmp_path / "house" / "__main__.py").write_text(PROGRAM)
    for name in ("sound", "killed", "broken"):
        for k in range(3):
            write_png(tmp_path / "captures" / name / "images" / f"{k}.png", np.full((8, 8, 3), 40 * k + 90, np.uint8))
    tools = tmp_path / "bin"
    tools.mkdir()
    for name in ("sbatch", "scontrol"):
        fake = f'#!/bin/sh\nexec {sys.executable} {Path(__file__).with_name("fake_sbatch.py")} {name} "$@"\n'
        (tools / name).write_text(fake)
        (tools / name).chmod(0o755)
    (tmp_path / "notes").mkdir()
    path = f"{tmp_path}{os.pathsep}{ROOT}"
    environment = {**os.environ, "PYTHONPATH": path, "FAKE_SLURM": str(tmp_path / "notes")}
    environment["PATH"] = f"{tools}{os.pathsep}{environment['PATH']}"

    def call(*more: str) -> subprocess.CompletedProcess[str]:
        line = [sys.executable, "-m", "house", "batch", "captures", "--dataset", "out", "--cores", "1", *more]
        return subprocess.run(line, cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=300)

    return call


def check(tmp_path: Path) -> None:
    """All that can be is done, once; the killed one at its second try, and the refused one not again."""
    found = {c["name"]: c for c in json.loads((tmp_path / "out" / "batch.json").read_text())["captures"]}
    assert {name: c["state"] for name, c in found.items()} == {"sound": "done", "killed": "done", "broken": "failed"}
    assert "is broken" in found["broken"]["line"]
    for name in ("sound", "killed"):
        assert (tmp_path / "out" / name / "two" / "current" / "out").read_text() == name
    ran = (tmp_path / "ran").read_text().split("\n")
    assert ran.count("sound one") == ran.count("sound two") == ran.count("broken one") == 1
    assert ran.count("killed one") == ran.count("killed two") == 2


def test_a_slurm_array_goes_on_after_kills_and_writes_the_table_when_it_has_ended(lab, tmp_path):
    done = lab("--slurm", "--sbatch=--partition=big --gpus=1")
    assert done.returncode == 0 and "of 3 captures" in done.stdout, done.stdout + done.stderr
    check(tmp_path)
    jobs = sorted((tmp_path / "notes").glob("job-*"))
    array, table = (job.read_text().splitlines() for job in jobs[:2])
    assert "--partition=big" in array and "--partition=big" in table and "--gpus=1" in array and "--gpus=1" not in table
    assert list((tmp_path / "notes").glob("requeue-*"))
    shutil.rmtree(tmp_path / "bin")
    shutil.rmtree(tmp_path / "out" / "sound")
    done = lab("--slurm")
    assert done.returncode == 2 and "sbatch: is not on this machine" in done.stderr and done.stderr.count("\n") == 1


@pytest.mark.skipif(importlib.util.find_spec("snakemake") is None, reason="needs the extra `cluster`")
def test_snakemake_goes_on_after_kills_and_does_nothing_twice(lab, tmp_path):
    done = lab("--snakemake", "--jobs", "2")
    assert done.returncode == 1, done.stdout + done.stderr
    check(tmp_path)
    (tmp_path / "captures" / "broken").rename(tmp_path / "aside")
    again = lab("--snakemake", "--jobs", "2")
    assert again.returncode == 0 and "2 done, 0 to do" in again.stdout
