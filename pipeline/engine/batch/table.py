"""batch.json and batch.html: every capture of a batch with its figures, times, warnings, and the line of what failed."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from pipeline.engine.batch.row import Row
from pipeline.engine.dataset.documents import read_object, write_whole
from pipeline.engine.progress import brief
from pipeline.report.render import render

SCHEMA = 1
COSTS = ("wall_s", "cpu_s", "peak_rss_mb")
FIGURES = "metrics.json"


def write_table(rows: Sequence[Row], folder: Path, report: str, wall_s: float) -> Path:
    """Write both files to `folder`; returns the page. `report`: the stage that leaves figures and the page of one capture."""
    captures = [facts_of(row, folder, report) for row in rows]
    counts = {state: sum(c["state"] == state for c in captures) for state in dict.fromkeys(c["state"] for c in captures)}
    table = {"schema": SCHEMA, "wall_s": round(wall_s, 1), "counts": counts, "captures": captures}
    write_whole(folder / "batch.json", json.dumps(table, indent=1) + "\n")
    page = folder / "batch.html"
    write_whole(page, render("batch.html.jinja", {**table, "figures": shown_figures(captures), "took": brief(wall_s)}))
    return page


def facts_of(row: Row, folder: Path, report: str) -> dict[str, Any]:
    """What the table tells of one capture."""
    dataset = row.dataset
    stages: dict[str, dict[str, Any]] = {}
    warnings = list(row.call.capture.warnings) if row.call is not None else []
    figures: dict[str, float] = {}
    page = ""
    for step in row.steps:
        version = dataset.find(step.stage.name, step.key) if step.decision.run else None
        if version is None:
            continue
        made = step.stage.name in row.made
        stages[step.stage.name] = {"made": made, **{k: version.manifest.get(k) for k in COSTS}}
        warnings += [str(w) for w in version.manifest.get("warnings", [])]
        if step.stage.name == report:
            figures = figures_of(read_object(version.folder / FIGURES) or {})
            page = os.path.relpath(dataset.place(version) / "report.html", folder)
    state = "unreadable" if row.fault and not row.at else "failed" if row.fault else "done" if row.done else "unfinished"
    return {
        "name": row.place.name,
        "capture": str(row.place.capture),
        "dataset": os.path.relpath(row.root, folder),
        "layout": row.call.capture.layout if row.call is not None else None,
        "state": state,
        "stage": row.at or None,
        "line": row.fault or None,
        "warnings": list(dict.fromkeys(warnings)),
        "wall_s": round(sum(s["wall_s"] or 0.0 for s in stages.values()), 3),
        "cpu_s": round(sum(s["cpu_s"] or 0.0 for s in stages.values()), 3),
        "peak_rss_mb": max((s["peak_rss_mb"] or 0.0 for s in stages.values()), default=None),
        "stages": stages,
        "figures": figures,
        "report": page or None,
    }


def figures_of(table: Mapping[str, Any]) -> dict[str, float]:
    """The figures of a metrics.json that are one number each, as STAGE.FIGURE; costs are told elsewhere."""
    return {
        f"{stage}.{name}": value
        for stage, figures in table.items()
        if isinstance(figures, dict)
        for name, value in figures.items()
        if isinstance(value, int | float) and not isinstance(value, bool) and name not in COSTS
    }


def shown_figures(captures: Sequence[Mapping[str, Any]]) -> list[str]:
    """The figures that the page has a column for, those of most captures first; the order is otherwise that of the stages."""
    count: dict[str, int] = {}
    for capture in captures:
        for name in capture["figures"]:
            count[name] = count.get(name, 0) + 1
    return sorted(count, key=lambda name: -count[name])
