"""Figures, costs and parameters of several results, row by row."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from stages.metrics.comparison.results import Result
from stages.metrics.report.figures import SKIPPED, describe, text_of

COSTS = ("wall_s", "cpu_s", "peak_rss_mb")
UP = ("psnr", "ssim", "likeness", "fscore", "correlation")
"""Words in the names of figures of which more is better; of errors, less is."""
ERRORS = (
    "mae", "error", "median_deg", "mean_deg", "p90_deg", "chamfer", "accuracy", "completeness", "flip", "lpips", "off",
    "residual",
)  # fmt: skip


@dataclass(frozen=True)
class Line:
    """A row: what it is, a value for each result (None: it has none), and which of them is best (None: no such thing)."""

    group: str
    title: str
    name: str
    values: list[Any]
    best: int | None

    @property
    def texts(self) -> list[str]:
        """The values with their units."""
        return [text_of(self.name, value) for value in self.values]


def figure_lines(results: Sequence[Result]) -> list[Line]:
    """Every figure that one of the results has, stage by stage."""
    flat = [_flat(result.metrics) for result in results]
    keys = dict.fromkeys(key for table in flat for key in table)
    return [_line(group, name, [table.get((group, name)) for table in flat]) for group, name in keys]


def cost_lines(results: Sequence[Result]) -> list[Line]:
    """Wall time, processor time and memory of every stage, and of all together."""
    stages = list(dict.fromkeys(s for result in results for s in result.manifests))
    lines = []
    for name in COSTS:
        for stage in stages:
            values = [result.manifests.get(stage, {}).get(name) for result in results]
            lines.append(_line(stage, name, values, least=True))
        total = [[m.get(name) or 0.0 for m in result.manifests.values()] for result in results]
        lines.append(_line("all", name, [max(t) if name == "peak_rss_mb" else sum(t) for t in total], least=True))
    return lines


def parameter_lines(results: Sequence[Result]) -> list[Line]:
    """Parameters that differ."""
    tables = [
        {(s, k): v for s, m in result.manifests.items() for k, v in m.get("parameters", {}).items()} for result in results
    ]
    keys = dict.fromkeys(key for table in tables for key in table)
    rows = [(key, [table.get(key) for table in tables]) for key in keys]
    return [Line(stage, name, name, values, None) for (stage, name), values in rows if any(v != values[0] for v in values)]


def _flat(metrics: Mapping[str, Any]) -> dict[tuple[str, str], float]:
    """(stage or "relight NAME", figure) -> number."""
    out: dict[tuple[str, str], float] = {}
    for stage, table in metrics.items():
        if not isinstance(table, Mapping) or stage in SKIPPED:
            continue
        for name, value in table.items():
            if isinstance(value, Mapping) and name not in SKIPPED:
                out |= {(f"{stage}, {name}", k): v for k, v in value.items() if _is_number(v) and k not in SKIPPED}
            elif _is_number(value) and name not in SKIPPED:
                out[stage, name] = value
    return out


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _line(group: str, name: str, values: list[Any], least: bool = False) -> Line:
    known = [v for v in values if v is not None]
    more = any(word in name for word in UP)
    best = None
    if len(known) > 1 and (more or least or any(word in name for word in ERRORS)) and len(set(known)) > 1:
        best = values.index(max(known) if more else min(known))
    return Line(group, describe(name).title, name, values, best)


def as_text(lines: Sequence[Line], names: Sequence[str]) -> str:
    """The lines as columns for a terminal; the best value of a row has a star."""
    rows = [["", *names]]
    for line in lines:
        cells = [text + (" *" if k == line.best else "  ") for k, text in enumerate(line.texts)]
        rows.append([f"{line.group}: {line.title}", *cells])
    widths = [max(len(row[k]) for row in rows) for k in range(len(rows[0]))]
    padded = ([row[0].ljust(widths[0]), *(c.rjust(w) for c, w in zip(row[1:], widths[1:]))] for row in rows)
    return "\n".join("  ".join(row).rstrip() for row in padded)
