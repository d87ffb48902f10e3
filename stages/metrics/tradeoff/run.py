"""Runs the pipeline with other parameters in a dataset beside the user's, and says which are worth it."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

from pipeline.engine.dataset import Dataset
from pipeline.engine.progress import clock
from pipeline.errors import UserError
from stages.metrics.comparison.results import Result, read_results
from stages.metrics.tradeoff.choose import best_within, finest, pareto
from stages.metrics.tradeoff.knobs import Trial, trials
from stages.metrics.tradeoff.measure import Measured, errors, measured, taken
from stages.metrics.tradeoff.page import write_page

BUDGET = 9.5  # of the run's own time, what all trials together may take: "under ten times" with room for the last estimate
HALF = 0.5
ATTEMPTS = 2
"""Combinations that are tried to be twice as fast: their time is kept for them while single parameters are tried."""
FINE = "as good as it gets"
FAST = "twice as fast"


class Tradeoff:
    """The trials of one capture; `dataset` is a folder of their own beside the user's dataset."""

    def __init__(self, capture: Path, dataset: Path, params: str, envs: str, say: Callable[[str], None]) -> None:
        self.capture, self.dataset, self.params, self.envs, self.say = capture, dataset, params, envs, say
        self.base: Measured | None = None
        self.spent = 0.0
        self.made: set[str] = set()
        self.runs: list[Measured] = []

    def make(self, changed: Mapping[str, Any]) -> Result:
        """A whole run with these parameters changed; what an earlier run has made is not made again. Raises UserError."""
        text = " ".join([self.params, *(Trial(k, v, 1.0).text for k, v in changed.items())]).strip()
        command = [sys.executable, "-m", "stages", "all", str(self.capture), "--dataset", str(self.dataset), "--quiet"]
        command += [f"--params={text}", f"--envs={self.envs}"]
        start = time.monotonic()
        done = subprocess.run(command, capture_output=True, text=True, env=_environment())
        self.spent += time.monotonic() - start
        if done.returncode:
            last = (done.stderr.strip().splitlines() or ["no word"])[-1].removeprefix("polarfield: ")
            raise UserError(self.capture, f"with {text or 'its own parameters'}: {last}", "mend that first")
        return read_results([self.dataset])[0]

    def try_out(self, changed: Mapping[str, Any]) -> Measured:
        """Run and measure, and keep the figure. What a busier machine adds to the trial's time is not spent: the user's own run
        would take as much longer."""
        assert self.base is not None
        before = self.spent
        result = self.make(changed)
        run = measured(result, changed, self.base.figures, self.base.pace)
        self.spent = before + (self.spent - before) / self._slowed(result, run)
        self.runs.append(run)
        self.say(f"{_line(changed)}: {clock(run.total)} ({run.total / self.base.total:.2f} of yours), error x {run.error:.3f}")
        return run

    def _slowed(self, result: Result, run: Measured) -> float:
        """How many times as long the stages took that this trial was the first to make, as they would have beside the user's
        own run; 1 at least."""
        fresh = [s for s, m in result.manifests.items() if m.get("key", "") not in self.made]
        self.made |= {str(m["key"]) for m in result.manifests.values() if "key" in m}
        wall = sum(taken(result.manifests[s])[0] for s in fresh)
        return max(1.0, wall / max(sum(run.seconds[s] for s in fresh), 1e-9))

    def affords(self, seconds: float) -> bool:
        """Whether a run that takes so long, as long as the others have on this machine meanwhile, is within the budget."""
        foreseen = sum(run.total for run in self.runs)
        busy = max(1.0, self.spent / foreseen) if foreseen > 0 else 1.0
        return self.base is not None and self.spent + busy * seconds <= BUDGET * self.base.total


def run_tradeoff(capture: Path, dataset: Path, params: str, envs: str, say: Callable[[str], None]) -> Path:
    """Try the parameters that matter to a capture and write tradeoff.html beside the dataset.

    Args:
        capture: its folder.
        dataset: the user's dataset, finished or not; what it holds is used and left as it is.
        params, envs: as given on the command line.
        say: shows a line of progress.

    Returns:
        The page.

    Raises:
        UserError: a run fails.
    """
    folder = dataset.with_name(dataset.name + "-tradeoff")
    work = Tradeoff(capture, folder / "dataset", params, envs, say)
    _seed(dataset, work.dataset)
    first = work.make({})
    work.base = measured(first, {}, errors(first.metrics), {})
    work.made = {str(m["key"]) for m in first.manifests.values() if "key" in m}
    work.spent = 0.0
    say(f"your run takes {clock(work.base.total)}; trials may take {clock(BUDGET * work.base.total)} together")
    kept = ATTEMPTS * HALF * work.base.total
    singles = [work.try_out({t.parameter: t.value}) for t in _trials(first) if work.affords(_guess(work.base, t) + kept)]
    fast = _twice_as_fast(work, singles)
    best = finest(work.base, singles)
    if len(best) > 1 and work.affords(sum(s.total for s in singles if set(s.changed) <= set(best))):
        work.try_out(best)
    fine = min([work.base, *work.runs], key=lambda run: run.error)
    lines = {FAST: fast, FINE: fine}
    folder.mkdir(parents=True, exist_ok=True)
    table = {"capture": str(capture), "params": params, "base": asdict(work.base), "runs": [asdict(r) for r in work.runs]}
    table |= {"lines": {name: None if run is None else _line(run.changed) for name, run in lines.items()}}
    (folder / "tradeoff.json").write_text(json.dumps(table, indent=1) + "\n")
    front = pareto([work.base, *work.runs])
    page = write_page(folder / "tradeoff.html", capture.name, work.base, work.runs, front, lines, _line)
    for name, run in lines.items():
        print(f"{name}: {_said(run, work.base)}")
    return page


def _twice_as_fast(work: Tradeoff, singles: list[Measured]) -> Measured | None:
    """A run in half the time with the smallest error found; aimed lower once if the first one promised too much."""
    assert work.base is not None
    target = HALF * work.base.total
    within = [run for run in work.runs if run.total <= target]
    aim = target
    for _ in range(ATTEMPTS):
        changed = best_within(work.base, singles, aim)
        if changed is None or not work.affords(target):
            break
        run = next((r for r in work.runs if r.changed == changed), None) or work.try_out(changed)
        if run.total <= target:
            within.append(run)
            break
        aim *= target / run.total
    return min(within, key=lambda run: run.error) if within else None


def _trials(result: Result) -> list[Trial]:
    """What to try, without passes that this capture's run left out."""
    left = [
        f"{stage}.{name}"
        for stage, manifest in result.manifests.items()
        for name, fact in manifest.get("facts", {}).items()
        if isinstance(fact, dict) and fact.get("run") is False
    ]
    return trials({stage: m.get("parameters", {}) for stage, m in result.manifests.items()}, left)


def _guess(base: Measured, trial: Trial) -> float:
    """Seconds that a trial will take: its own stage, and all after it."""
    stages = list(base.seconds)
    order = ["decode", "poses", "masks", "olat", "train", "mesh", "relight", "metrics"]
    later = [s for s in stages if order.index(s) > order.index(trial.stage)]
    return base.seconds.get(trial.stage, 0.0) * trial.cost + sum(base.seconds[s] for s in later)


def _seed(dataset: Path, work: Path) -> None:
    """Put what the user's dataset holds at the trials' hand, as hard links (copies where the file system has none)."""
    source = Dataset(dataset)
    if not source.exists:
        return
    for manifest in sorted(dataset.glob("*/*/manifest.json")):
        folder = manifest.parent
        target = work / folder.relative_to(dataset)
        if folder.is_symlink() or target.exists():
            continue
        part = target.with_name(target.name + ".part")
        shutil.rmtree(part, ignore_errors=True)
        shutil.copytree(folder, part, copy_function=_link)
        part.rename(target)


def _link(source: str, target: str) -> None:
    try:
        os.link(source, target)
    except OSError:
        shutil.copy2(source, target)


def _environment() -> dict[str, str]:
    path = os.pathsep.join(filter(None, [str(Path(__file__).parents[3]), os.environ.get("PYTHONPATH", "")]))
    return {**os.environ, "PYTHONPATH": path}


def _line(changed: Mapping[str, Any]) -> str:
    """PARAMS to copy."""
    return " ".join(Trial(k, v, 1.0).text for k, v in changed.items()) or "as it is"


def _said(run: Measured | None, base: Measured) -> str:
    if run is None:
        return "no trial took half the time: most of it is start-up, or lies in stages without such parameters"
    if not run.changed:
        return "your own parameters: nothing that was tried is better"
    return f'PARAMS="{_line(run.changed)}"  {clock(run.total)} instead of {clock(base.total)}, error x {run.error:.3f}'
