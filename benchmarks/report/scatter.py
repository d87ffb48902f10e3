"""A plot as SVG text: labelled points, error over time, both logarithmic. No library, so that a page is the same everywhere."""

from __future__ import annotations

import html
import math
from collections.abc import Sequence
from dataclasses import dataclass

WIDTH, HEIGHT, LEFT, RIGHT, TOP, BOTTOM = 720, 400, 78, 190, 14, 46
COLOURS = ("#2563eb", "#d97706", "#059669", "#dc2626", "#7c3aed", "#0891b2", "#64748b", "#be185d")
SYMBOL_PX = 5


@dataclass(frozen=True)
class Point:
    """One way of doing it: its series (a capture), label, run time and error; `default`: the program's own choice."""

    series: str
    label: str
    time: float
    error: float
    default: bool = False


def scatter(points: Sequence[Point], x_title: str, y_title: str) -> str:
    """The plot; defaults are ringed, points of one series share a colour. Empty without a point above 0 in both."""
    points = [p for p in points if p.time > 0 and p.error > 0]
    if not points:
        return ""
    x = _Axis([p.time for p in points], LEFT, WIDTH - RIGHT)
    y = _Axis([p.error for p in points], HEIGHT - BOTTOM, TOP)
    series = list(dict.fromkeys(p.series for p in points))
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {HEIGHT}" font-family="sans-serif" font-size="11">',
        f'<rect width="{WIDTH}" height="{HEIGHT}" fill="#ffffff"/>',
    ]
    for value in x.ticks():
        parts.append(_line(x.at(value), TOP, x.at(value), HEIGHT - BOTTOM))
        parts.append(_text(x.at(value), HEIGHT - BOTTOM + 16, _number(value), "middle"))
    for value in y.ticks():
        parts.append(_line(LEFT, y.at(value), WIDTH - RIGHT, y.at(value)))
        parts.append(_text(LEFT - 6, y.at(value) + 4, _number(value), "end"))
    for p in points:
        colour = COLOURS[series.index(p.series) % len(COLOURS)]
        place = f'cx="{x.at(p.time):.1f}" cy="{y.at(p.error):.1f}"'
        if p.default:
            parts.append(f'<circle {place} r="{SYMBOL_PX + 4}" fill="none" stroke="{colour}" stroke-width="1.5"/>')
        title = html.escape(f"{p.series}, {p.label}: {_number(p.time)}, {_number(p.error)}")
        parts.append(f'<circle {place} r="{SYMBOL_PX}" fill="{colour}"><title>{title}</title></circle>')
    labels = list(dict.fromkeys(p.label for p in points)) if len(series) == 1 else []
    for p in points if labels else ():
        parts.append(_text(x.at(p.time) + 9, y.at(p.error) - 6, p.label, "start"))
    for k, name in enumerate(series if len(series) > 1 else []):
        at = TOP + 14 + 18 * k
        parts.append(f'<circle cx="{WIDTH - RIGHT + 16}" cy="{at - 4}" r="5" fill="{COLOURS[k % len(COLOURS)]}"/>')
        parts.append(_text(WIDTH - RIGHT + 26, at, name, "start"))
    parts.append(_text((LEFT + WIDTH - RIGHT) / 2, HEIGHT - 8, x_title, "middle"))
    parts.append(
        f'<g transform="translate(16 {(HEIGHT - BOTTOM + TOP) / 2:.0f}) rotate(-90)">{_text(0, 0, y_title, "middle")}</g>'
    )
    return "\n".join([*parts, "</svg>"]) + "\n"


class _Axis:
    """A logarithmic axis from pixel `start` to `end`, with room about the values."""

    def __init__(self, values: Sequence[float], start: float, end: float) -> None:
        low, high = math.log10(min(values)), math.log10(max(values))
        room = max(0.08 * (high - low), 0.05)
        self.low, self.high, self.start, self.end = low - room, high + room, start, end

    def at(self, value: float) -> float:
        """The pixel of a value."""
        return self.start + (math.log10(value) - self.low) / (self.high - self.low) * (self.end - self.start)

    def ticks(self) -> list[float]:
        """Powers of ten, with 2 and 5 between them where there are few."""
        every = max(1, round((self.high - self.low) / 8))  # decades between ticks
        decades = range(every * math.floor(self.low / every), math.ceil(self.high) + 1, every)
        for steps in ((1,), (1, 3), (1, 2, 5), (1, 1.5, 2, 3, 4, 5, 6, 7, 8, 9)):
            found = [m * 10.0**d for d in decades for m in steps if self.low <= math.log10(m * 10.0**d) <= self.high]
            if len(found) >= 3:
                return found
        return found


def _line(x0: float, y0: float, x1: float, y1: float) -> str:
    return f'<line x1="{x0:.1f}" y1="{y0:.1f}" x2="{x1:.1f}" y2="{y1:.1f}" stroke="#e5e7eb"/>'


def _text(x: float, y: float, text: str, anchor: str) -> str:
    return f'<text x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}" fill="#374151">{html.escape(text)}</text>'


def _number(value: float) -> str:
    return f"{value:.3g}"
