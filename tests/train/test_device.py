"""Training on another device than the CPU: no tensor is left on the wrong side, and little waits for the device."""

from __future__ import annotations

import json
import os
import pickle
import subprocess
import sys
from pathlib import Path

import pytest

STEPS = 8  # it links at every other step from 0, traces and densifies at 4; the last is a plain one


@pytest.mark.slow
def test_training_on_another_device_is_training_on_the_cpu(tmp_path, make_sources):
    """The stand-in refuses what a GPU would refuse. Its steps are the definitions in torch, the CPU's are fused kernels."""
    sources = tmp_path / "sources.pkl"
    sources.write_bytes(pickle.dumps(make_sources(32, 8)))
    script = Path(__file__).with_name("train_on_standin.py")
    told = {}
    for device in ("cpu", "standin"):
        command = [sys.executable, script, sources, device, str(STEPS)]
        path = os.pathsep.join([str(Path(__file__).parents[2]), os.environ.get("PYTHONPATH", "")])
        run = subprocess.run(command, env={**os.environ, "PYTHONPATH": path}, capture_output=True, text=True, check=False)
        assert run.returncode == 0, run.stderr[-3000:]
        told[device] = json.loads(run.stdout)
    assert told["standin"]["traced"] and told["cpu"]["traced"]
    for there, here in zip(told["standin"]["losses"], told["cpu"]["losses"]):
        assert there == pytest.approx(here, rel=2e-3, abs=1e-6)
    # Culling, the splats' median width, and the losses for the log; gsplat adds its own.
    assert sum(told["standin"]["waits"].values()) <= 3, told["standin"]["waits"]
