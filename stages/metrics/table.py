"""Figures of one stage as metrics.json keeps them: numbers, rows per view, and a reason for every null."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np


@dataclass
class Table:
    """Figures of one stage. `parts` are tables of their own (a camera of a light stage, an environment); `doubts` are lines for
    the user."""

    figures: dict[str, Any] = field(default_factory=dict)
    rows: list[dict[str, Any]] = field(default_factory=list)
    why: dict[str, str] = field(default_factory=dict)
    parts: dict[str, Table] = field(default_factory=dict)
    doubts: list[str] = field(default_factory=list)

    def missing(self, names: Iterable[str], reason: str) -> None:
        """Mark figures that are not there as null, with the reason."""
        for name in names:
            if self.figures.get(name) is None:
                self.figures[name] = None
                self.why[name] = reason

    def means(self, names: Iterable[str] | None = None) -> None:
        """Each figure of the rows as its mean over the views that have it."""
        wanted = names or dict.fromkeys(k for row in self.rows for k in row if k != "view")
        for name in wanted:
            values = [row[name] for row in self.rows if row.get(name) is not None]
            if values:
                self.figures[name] = float(np.mean(values))

    def as_json(self) -> dict[str, Any]:
        """The form in metrics.json; numbers that are not finite become null."""
        out: dict[str, Any] = {name: part.as_json() for name, part in self.parts.items()}
        why = dict(self.why)
        for name, value in self.figures.items():
            out[name] = clean(value)
            if out[name] is None and name not in why:
                why[name] = "not a finite number"
        if self.rows:
            out["views"] = [{k: clean(v) for k, v in row.items()} for row in self.rows]
        if why:
            out["why"] = why
        return out


def clean(value: Any) -> Any:
    """Plain JSON: numpy scalars as numbers, NaN and infinities as None."""
    if isinstance(value, Mapping):
        return {k: clean(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [clean(v) for v in value]
    if isinstance(value, np.integer):
        return int(value)
    if isinstance(value, float | np.floating):
        return float(value) if np.isfinite(value) else None
    return value
