"""A sample of all the moments at which a run can be stopped; `make crash-test` tries every one."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

HERE = Path(__file__).parent
COMPILER = shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")
ALL = "exit,eio,enospc,kill,power"
pytestmark = [pytest.mark.slow, pytest.mark.skipif(COMPILER is None, reason="no C compiler is here")]


def points(*arguments: str) -> subprocess.CompletedProcess[str]:
    line = [sys.executable, str(HERE / "points.py"), *arguments]
    return subprocess.run(line, cwd=HERE.parents[1], capture_output=True, text=True, timeout=900)


@pytest.mark.parametrize(("scene", "every", "ways"), [("stub", "40", ALL), ("real", "240", ALL)])
def test_a_run_that_is_stopped_before_a_change_to_the_disk_is_mended_by_the_same_command(scene, every, ways):
    done = points("--scenes", scene, "--every", every, "--ways", ways)
    assert done.returncode == 0, done.stdout + done.stderr
    found = re.search(r"(\d+) points, (\d+) stops tried, 0 not mended", done.stdout)
    assert found and int(found[1]) > 100 and int(found[2]) >= int(found[1]) // int(every), done.stdout


def test_a_stage_that_a_stop_does_harm_to_is_found():
    done = points("--scenes", "careless", "--ways", "exit", "--every", "8")
    assert done.returncode == 1 and "differs: " in done.stdout, done.stdout + done.stderr


def test_what_random_kills_leave_is_mended_by_the_same_commands():
    done = subprocess.run(
        [sys.executable, str(HERE / "kills.py"), "--kills", "12", "--scenes", "stub"],
        cwd=HERE.parents[1], capture_output=True, text=True, timeout=900,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    assert re.search(r"stub: \d+ kills, 0 not mended", done.stdout), done.stdout
