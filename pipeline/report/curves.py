"""Line charts as inline SVG that takes its colours from the page, so that it follows light and dark."""

from __future__ import annotations

import html
from collections.abc import Mapping, Sequence

import numpy as np

WIDTH, HEIGHT = 560, 250
LEFT, RIGHT, TOP, BOTTOM = 54, 14, 14, 40
COLOURS = ("var(--a)", "var(--b)", "var(--c)", "var(--d)", "var(--e)", "var(--f)")


def nice_ticks(low: float, high: float, about: int = 5) -> list[float]:
    """Round numbers that cover [low, high]."""
    if not high > low:
        return [low]
    raw = (high - low) / about
    base = 10.0 ** np.floor(np.log10(raw))
    step = base * min((m for m in (1, 2, 2.5, 5, 10) if m * base >= raw), default=10)
    first = np.ceil(low / step)
    return [float(k * step) for k in np.arange(first, np.floor(high / step + 1e-9) + 1)]


def _label(value: float) -> str:
    return f"{value:g}" if abs(value) < 1e5 else f"{value:.0e}"


def line_chart(x: Sequence[float], series: Mapping[str, Sequence[float]], x_title: str, y_title: str, log: bool = False) -> str:
    """Draw a line chart as SVG that takes its colours from the page.

    Args:
        x: shared by all series.
        series: name to its values at `x`; gaps where they are not finite.
        x_title, y_title: of the axes.
        log: put y on a logarithmic axis; values not above 0 are gaps.

    Returns:
        The SVG element; "" where there are fewer than two places or nothing finite.
    """
    xs = np.asarray(x, float)
    ys = {k: np.asarray(v, float) for k, v in series.items()}
    if log:
        ys = {k: np.log10(np.where(v > 0, v, np.nan)) for k, v in ys.items()}
    ys = {k: v for k, v in ys.items() if np.isfinite(v).any()}
    if not ys or len(xs) < 2:
        return ""
    values = np.concatenate([v[np.isfinite(v)] for v in ys.values()])
    low, high = float(values.min()), float(values.max())
    flat = [low] if high == low else None
    pad = 0.06 * (high - low) or 0.5
    low, high = low - pad, high + pad
    x0, x1 = float(xs.min()), float(max(xs.max(), xs.min() + 1e-9))

    def px(v: float) -> float:
        return LEFT + (v - x0) / (x1 - x0) * (WIDTH - LEFT - RIGHT)

    def py(v: float) -> float:
        return HEIGHT - BOTTOM - (v - low) / (high - low) * (HEIGHT - TOP - BOTTOM)

    parts = [f'<svg class="chart" viewBox="0 0 {WIDTH} {HEIGHT}" role="img" aria-label="{html.escape(y_title)}">']
    for t in flat or nice_ticks(low, high):
        text = _label(10**t) if log else _label(round(t, 10))
        if log and abs(t - round(t)) > 1e-9 and high - low > 1.5:
            continue
        text = f"{10**t:.2g}" if log else text
        parts.append(f'<line class="grid" x1="{LEFT}" x2="{WIDTH - RIGHT}" y1="{py(t):.1f}" y2="{py(t):.1f}"/>')
        parts.append(f'<text x="{LEFT - 7}" y="{py(t) + 4:.1f}" text-anchor="end">{text}</text>')
    for t in nice_ticks(x0, x1, 6):
        parts.append(f'<text x="{px(t):.1f}" y="{HEIGHT - BOTTOM + 17}" text-anchor="middle">{_label(t)}</text>')
    for (_, v), colour in zip(ys.items(), COLOURS * 3):
        runs: list[list[str]] = [[]]
        for a, b in zip(xs, v):
            if np.isfinite(b):
                runs[-1].append(f"{px(a):.1f},{py(b):.1f}")
            elif runs[-1]:
                runs.append([])
        for run in runs:
            if run:
                parts.append(f'<polyline fill="none" stroke="{colour}" stroke-width="1.8" points="{" ".join(run)}"/>')
    parts.append(
        f'<text x="{(LEFT + WIDTH - RIGHT) / 2}" y="{HEIGHT - 6}" text-anchor="middle">{html.escape(x_title)}</text></svg>'
    )
    keys = "".join(f'<span><i style="background:{c}"></i>{html.escape(k)}</span>' for (k, _), c in zip(ys.items(), COLOURS * 3))
    caption = f'<figcaption>{html.escape(y_title)}<span class="key">{keys}</span></figcaption>'
    return f'<figure class="plot">{caption}{"".join(parts)}</figure>'
