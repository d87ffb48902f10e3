"""A part of the benchmarks' page, and how its figures are written."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from benchmarks.report.scatter import Point

Rows = list[list[str]]
"""A table: heads, then cells."""


@dataclass(frozen=True)
class Section:
    """A part of the page; `plots`: (name, points, title of the time axis, title of the error axis)."""

    title: str
    text: str
    rows: Rows
    plots: list[tuple[str, list[Point], str, str]] = field(default_factory=list)


def number(value: Any, digits: int = 3) -> str:
    """A figure as text."""
    return value if isinstance(value, str) else "" if value is None else f"{value:.{digits}g}"
