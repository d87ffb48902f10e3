"""A sample of the hostile captures and datasets; `make hostile` tries all of them, and results of a training and of a rig."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

EVERY = 67


@pytest.mark.slow
def test_a_sample_of_hostile_captures_and_datasets_is_held():
    run = [sys.executable, str(Path(__file__).with_name("run.py")), "--every", str(EVERY), "--kinds", "capture,dataset"]
    done = subprocess.run(run, capture_output=True, text=True, timeout=600)
    assert done.returncode == 0, done.stdout + done.stderr
    assert " 0 not held" in done.stdout
