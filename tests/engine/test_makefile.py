"""make: values reach the command as they stand, and a misspelt variable is reported instead of ignored."""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
pytestmark = pytest.mark.skipif(shutil.which("make") is None, reason="make is not installed")


@pytest.fixture
def make(tmp_path):
    """Run make over an environment whose polarfield prints its arguments, one a line."""
    script = tmp_path / "bin" / "polarfield"
    script.parent.mkdir()
    script.write_text('#!/bin/sh\nprintf "%s\\n" "$@"\n')
    script.chmod(0o755)
    for done in (".installed", ".ready"):  # newer than what they depend on
        (tmp_path / done).touch()
    environment = {k: v for k, v in os.environ.items() if k not in ("MAKEFLAGS", "CAPTURE", "DATASET", "PARAMS", "ENVS")}

    def call(*arguments: str) -> subprocess.CompletedProcess[str]:
        line = ["make", "--no-print-directory", f"VENV={tmp_path}", *arguments]
        return subprocess.run(line, cwd=ROOT, env=environment, capture_output=True, text=True, timeout=30)

    return call


def test_values_with_spaces_and_quotes_reach_the_command_whole(make):
    done = make("all", "CAPTURE=a b", "DATASET=c d", "ENVS='x y.hdr' z.hdr", "PARAMS=train.iterations=5 mesh.poisson=true")
    assert done.returncode == 0, done.stderr
    said = done.stdout.splitlines()
    assert said[:2] == ["all", "a b"] and "--dataset=c d" in said
    assert "--envs='x y.hdr' z.hdr" in said and "--params=train.iterations=5 mesh.poisson=true" in said


def test_collection_takes_its_two_switches(make):
    assert make("gc", "DATASET=d", "DRY_RUN=1").stdout.splitlines()[-1] == "--dry-run"
    assert make("gc", "DATASET=d", "YES=1").stdout.splitlines()[-1] == "--yes"


def test_a_misspelt_variable_is_refused_with_those_that_are_known(make):
    done = make("all", "CAPTUR=x")
    assert done.returncode == 2 and "CAPTUR= is not a variable" in done.stderr and "CAPTURE=" in done.stderr


def test_make_expands_nothing_in_a_value(make, tmp_path):
    mark = tmp_path / "mark"
    trap = f"$(shell touch {mark})"
    done = make("all", "CAPTURE=pri$ce", f"DATASET=a {trap}", f"PARAMS={trap}", f"ENVS=$$x {trap}", "JOBS=$(DEVICE)")
    assert done.returncode == 0, done.stderr
    said = done.stdout.splitlines()
    assert said[1] == "pri$ce" and f"--dataset=a {trap}" in said and f"--envs=$$x {trap}" in said
    assert f"--params={trap}" in said and "--jobs=$(DEVICE)" in said
    assert make("gc", f"YES={trap}", "DATASET=d").returncode == 0
    assert not mark.exists()


def test_verification_takes_its_two_switches(make):
    assert make("verify", "DATASET=d", "FULL=1", "REPAIR=1").stdout.splitlines()[-2:] == ["--full", "--repair"]
