"""A stored result of a benchmark was made with today's defaults, or says with which others."""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import asdict
from pathlib import Path

import pytest

from stages.train.parameters import TrainParameters

ROOT = Path(__file__).parents[2]
TRAIN = json.loads((ROOT / "benchmarks" / "results" / "train.json").read_text(encoding="utf-8"))


@pytest.mark.parametrize("capture", sorted(TRAIN["captures"]))
def test_stored_trainings_say_which_defaults_have_changed_since(capture):
    """`defaults_since`: [then, now] by parameter; null where there is none of that name."""
    then, now = TRAIN["captures"][capture]["stokes"]["parameters"], asdict(TrainParameters())
    changed = {name: [then.get(name), now.get(name)] for name in then | now if then.get(name) != now.get(name)}
    assert TRAIN.get("defaults_since", {}) == changed, "run `make bench-train`, or say in the file what has changed"


@pytest.mark.parametrize("capture", sorted(TRAIN["captures"]))
def test_a_piece_that_was_changed_changed_something(capture):
    runs = TRAIN["captures"][capture]
    figures = {name: [{k: v for k, v in row.items() if k != "train_s"} for row in run["curve"]] for name, run in runs.items()}
    same = [name for name, curve in figures.items() if name != "all pieces" and curve == figures["all pieces"]]
    assert same == [], "these rows switch nothing off: leave them out"


def test_the_pages_of_figures_say_what_the_stored_results_say():
    """Whoever changes a stored number or a page by hand, and not the other, is told."""
    done = subprocess.run([sys.executable, "-m", "benchmarks.report", "--check"], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
