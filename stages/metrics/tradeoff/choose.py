"""From runs with one parameter changed to those worth a line: the Pareto curve, and combinations that are predicted to be."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product
from math import prod
from typing import Any

from stages.metrics.tradeoff.measure import Measured


def pareto(runs: Sequence[Measured]) -> list[Measured]:
    """The runs that no other beats in both time and error, fastest first."""
    out: list[Measured] = []
    for run in sorted(runs, key=lambda r: (r.total, r.error)):
        if not out or run.error < out[-1].error:
            out.append(run)
    return out


def predicted(base: Measured, changes: Sequence[Measured]) -> tuple[float, float]:
    """(seconds, error) of several single changes together: each acts on its stages' time and on the error by its own factor.

    What a trial took longer in other stages than its own is what else the machine did meanwhile.
    """
    seconds = sum(own * prod(_factor(change, stage, own) for change in changes) for stage, own in base.seconds.items())
    return seconds, base.error * prod(change.error / base.error for change in changes)


def _factor(change: Measured, stage: str, own: float) -> float:
    """How many times as long a stage of `own` seconds takes with one parameter changed."""
    factor = change.seconds.get(stage, own) / own if own > 0 else 1.0
    return factor if any(name.startswith(f"{stage}.") for name in change.changed) else min(1.0, factor)


def best_within(base: Measured, singles: Sequence[Measured], seconds: float) -> dict[str, Any] | None:
    """The changed parameters that promise the smallest error within so many seconds; None where no combination does."""
    best, found = float("inf"), None
    for changes in _combinations(singles):
        time, error = predicted(base, changes)
        if time <= seconds and error < best:
            best, found = error, _merged(changes)
    return found


def finest(base: Measured, singles: Sequence[Measured]) -> dict[str, Any]:
    """The changed parameters that promise the smallest error, whatever they take."""
    return _merged(min(_combinations(singles), key=lambda changes: (predicted(base, changes)[1], predicted(base, changes)[0])))


def _combinations(singles: Sequence[Measured]) -> list[list[Measured]]:
    """At most one run of every parameter."""
    by_name: dict[str, list[Measured | None]] = {}
    for run in singles:
        by_name.setdefault(next(iter(run.changed)), [None]).append(run)
    return [[run for run in chosen if run is not None] for chosen in product(*by_name.values())]


def _merged(changes: Sequence[Measured]) -> dict[str, Any]:
    return {name: value for run in changes for name, value in run.changed.items()}
