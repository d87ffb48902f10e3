"""tradeoff.html: error against run time, the Pareto curve, and the two lines to copy."""

from __future__ import annotations

import html
import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from pipeline.engine.progress import clock
from pipeline.report.render import render
from stages.metrics.tradeoff.measure import Measured

WIDTH, HEIGHT, LEFT, BOTTOM, TOP, RIGHT = 760, 420, 64, 48, 16, 20


def write_page(
    path: Path, name: str, base: Measured, runs: Sequence[Measured], front: Sequence[Measured],
    lines: Mapping[str, Measured | None], line: Callable[[Mapping[str, Any]], str],
) -> Path:  # fmt: skip
    """Write the page; `line` turns changed parameters into PARAMS. Returns the path."""
    shown = [base, *runs]
    rows = [
        {"text": "yours" if not r.changed else line(r.changed), "time": clock(r.total), "share": f"{r.total / base.total:.2f}",
         "error": f"{r.error:.3f}", "front": r in front}
        for r in sorted(shown, key=lambda r: r.total)
    ]  # fmt: skip
    chosen = [
        {"name": n, "text": "" if r is None else line(r.changed), "time": "" if r is None else clock(r.total),
         "share": "" if r is None else f"{r.total / base.total:.2f}", "error": "" if r is None else f"{r.error:.3f}"}
        for n, r in lines.items()
    ]  # fmt: skip
    context = {
        "name": name,
        "rows": rows,
        "chosen": chosen,
        "plot": scatter(shown, front, line),
        "figures": sorted(base.figures),
    }
    path.write_text(render("tradeoff.html.jinja", context, Path(__file__).parent), encoding="utf-8")
    return path


def scatter(runs: Sequence[Measured], front: Sequence[Measured], line: Callable[[Mapping[str, Any]], str]) -> str:
    """Runs as points on logarithmic axes (SVG), and the Pareto curve; the first run is the user's."""
    times, errors = [math.log(r.total) for r in runs], [math.log(r.error) for r in runs]
    x0, x1 = min(times) - 0.05, max(times) + 0.05
    y0, y1 = min(errors) - 0.02, max(errors) + 0.02

    def x(run: Measured) -> float:
        return LEFT + (math.log(run.total) - x0) / (x1 - x0) * (WIDTH - LEFT - RIGHT)

    def y(value: float) -> float:
        return HEIGHT - BOTTOM - (math.log(value) - y0) / (y1 - y0) * (HEIGHT - TOP - BOTTOM)

    parts = [f'<svg class="chart" viewBox="0 0 {WIDTH} {HEIGHT}" role="img" aria-label="error against run time">']
    for k in range(5):
        value, seconds = math.exp(y0 + (y1 - y0) * k / 4), math.exp(x0 + (x1 - x0) * k / 4)
        across = LEFT + (WIDTH - LEFT - RIGHT) * k / 4
        parts.append(f'<line class="grid" x1="{LEFT}" x2="{WIDTH - RIGHT}" y1="{y(value):.1f}" y2="{y(value):.1f}"/>')
        parts.append(f'<text x="{LEFT - 8}" y="{y(value) + 4:.1f}" text-anchor="end">{value:.2f}</text>')
        parts.append(
            f'<text x="{across:.1f}" y="{HEIGHT - BOTTOM + 18}" text-anchor="middle">{html.escape(clock(seconds))}</text>'
        )
    middle = (LEFT + WIDTH - RIGHT) / 2
    parts.append(f'<text x="{middle}" y="{HEIGHT - 6}" text-anchor="middle">run time of all stages (logarithmic)</text>')
    parts.append(f'<text transform="translate(14 {HEIGHT / 2}) rotate(-90)" text-anchor="middle">error, yours = 1</text>')
    corner = " ".join(f"{x(r):.1f},{y(r.error):.1f}" for r in front)
    parts.append(f'<polyline fill="none" stroke="currentColor" stroke-width="1.5" points="{corner}"/>')
    for k, run in enumerate(runs):
        fill = "#d97706" if k == 0 else "#2563eb" if run in front else "#94a3b8"
        title = "yours" if not run.changed else line(run.changed)
        label = f"{title}: {clock(run.total)}, error x {run.error:.3f}"
        point = f'<circle cx="{x(run):.1f}" cy="{y(run.error):.1f}" r="6" fill="{fill}">'
        parts.append(f"{point}<title>{html.escape(label)}</title></circle>")
    return "".join([*parts, "</svg>"])
