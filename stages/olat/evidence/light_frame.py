"""Is the light table in the cameras' world? Mirrored, negated, z up or permuted tables, named by what fits instead.

Shading alone cannot tell: a matte surface under turned or mirrored lights looks like the turned or mirrored surface under the
right ones. What tells is what the camera knows: visible surfaces face it, a highlight's half vector is the normal, and at the
object's outline the normal points out of it.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import permutations, product

import numpy as np
from numpy.typing import NDArray

FEWEST = 20  # pixels of a kind, below which that kind says nothing
BRIGHT = 0.5  # of a pixel's brightest specular sample: what makes its highlight
SHINY = 5.0  # brightest specular sample over the noise, from which a highlight is one
NARROW = 0.7  # length of a highlight's mean direction below which light comes from all sides
AROUND, GAP_RAD = 12, np.radians(150.0)
"""Nearest lights that surround a light where no gap between their bearings is wider: at a rig's edge it is half a turn."""
STEEP = 0.3  # sine of the angle to the view above which a normal has a direction in the image
DISAGREE_RAD = 0.35  # angle between normals and half vectors that counts 1: other frames are 20 to 90 degrees off
TURNED_RAD, SPACING = 0.12, 0.2
"""The same angle above which a table is turned, at best and per distance between neighbouring lights, whose half vectors lie
half as far apart: sound stages have 0.016 to 0.045 with 346 lights 0.19 apart, 0.06 with 40 lights 0.5 apart."""
WRONG, FAR, CLEARLY = 0.5, 1.5, 0.5
"""Total of the three from which a frame is doubted, from which it is wrong even if no other is known, and the share of it that
another must stay below to be named."""
AXES = "xyz"


@dataclass(frozen=True)
class Look:
    """What pixels tell: `normal` [P, 3] by the table, `view` [P, 3] to the camera, `peak` [P, 3] unit direction of the light at
    the highlight by the table (0 where there is none), `outward` [P, 3] out of the object at its outline, in the image plane (0
    elsewhere)."""

    normal: NDArray[np.float64]
    view: NDArray[np.float64]
    peak: NDArray[np.float64]
    outward: NDArray[np.float64]


@dataclass(frozen=True)
class Fit:
    """How well a frame explains them: share of normals that face away, median angle (rad) of normals and half vectors, and 1
    less the mean cosine of normals and outline; NaN where too few pixels tell."""

    away: float
    highlight: float
    outline: float

    @property
    def total(self) -> float:
        """0 fits."""
        parts = (self.away / 0.5, self.highlight / DISAGREE_RAD, self.outline)
        return float(np.nansum(parts))


def peaks(shine: NDArray[np.float64], noise: NDArray[np.float64], w: NDArray[np.float64]) -> NDArray[np.float64]:
    """Directions [P, 3] of the highlights in specular samples [N, P]; 0 where none stands out of the `noise` [P], and where one
    reaches the rig's edge: its peak may lie beyond."""
    top = shine.max(0)
    weight = np.where(shine > BRIGHT * top, shine, 0.0)
    mean = weight.T @ w
    size = np.linalg.norm(mean, axis=1, keepdims=True)
    narrow = size[:, 0] > NARROW * weight.sum(0)
    whole = ~np.any(weight[~surrounded(w)] > 0, axis=0)
    return np.where(((top > SHINY * noise) & (top > 0) & narrow & whole)[:, None], mean / np.maximum(size, 1e-30), 0.0)


def surrounded(w: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Which lights, of directions w [N, 3], have others on all sides [N]: not those at the edge of a dome or of a hole."""
    cosine = w @ w.T
    np.fill_diagonal(cosine, -np.inf)
    count = min(AROUND, len(w) - 1)
    near = w[np.argpartition(-cosine, count - 1, axis=1)[:, :count]]
    along = np.cross(w, np.eye(3)[np.argmin(np.abs(w), 1)])
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    x, y = (np.einsum("nki,ni->nk", near, axis) for axis in (along, np.cross(w, along)))
    bearing = np.sort(np.arctan2(y, x), 1)
    gap = np.diff(bearing, axis=1, append=bearing[:, :1] + 2 * np.pi)
    return np.asarray(gap.max(1) < GAP_RAD)


def judge(look: Look, turn: NDArray[np.float64]) -> Fit:
    """The frame in which the table's directions are to be multiplied by `turn` [3, 3]."""
    normal, peak = look.normal @ turn.T, look.peak @ turn.T
    away = float(np.mean(np.sum(normal * look.view, 1) < 0))
    shiny = np.any(peak != 0, 1)
    highlight = np.nan
    if shiny.sum() >= FEWEST:
        half = peak[shiny] + look.view[shiny]
        cosine = np.sum(half * normal[shiny], 1) / np.maximum(np.linalg.norm(half, axis=1), 1e-9)
        highlight = float(np.median(np.arccos(np.clip(cosine, -1, 1))))
    flat = normal - look.view * np.sum(normal * look.view, 1, keepdims=True)
    size = np.linalg.norm(flat, axis=1)
    edge = np.any(look.outward != 0, 1) & (size > STEEP)
    outline = np.nan
    if edge.sum() >= FEWEST:
        outline = 1.0 - float(np.mean(np.sum(flat[edge] * look.outward[edge], 1) / size[edge]))
    return Fit(away, highlight, outline)


def spacing(w: NDArray[np.float64]) -> float:
    """Usual angle (rad) between a light and its nearest neighbour, directions [N, 3]."""
    cosine = w @ w.T
    np.fill_diagonal(cosine, -1.0)
    return float(np.median(np.arccos(np.clip(cosine.max(1), -1, 1))))


def turns() -> Iterator[NDArray[np.float64]]:
    """The 48 ways to permute and negate axes, the identity first."""
    for order in permutations(range(3)):
        for signs in product((1.0, -1.0), repeat=3):
            matrix = np.zeros((3, 3))
            matrix[range(3), order] = signs
            yield matrix


def spoken(turn: NDArray[np.float64]) -> str:
    """A turn as the columns that a table should have: (x, -z, y)."""
    names = []
    for row in turn:
        k = int(np.argmax(np.abs(row)))
        names.append(("-" if row[k] < 0 else "") + AXES[k])
    return f"({', '.join(names)})"


def find_frame(look: Look) -> tuple[Fit, NDArray[np.float64] | None, Fit]:
    """(how the table fits as it is, the turn that fits clearly better or None, how well that does).

    None also where the table is not to be doubted, or several fit alike.
    """
    found = [(judge(look, turn), turn) for turn in turns()]
    here = found[0][0]
    order = sorted(range(len(found)), key=lambda k: found[k][0].total)
    best, second = found[order[0]], found[order[1]]
    clear = best[0].total < CLEARLY * here.total and best[0].total < CLEARLY * second[0].total
    named = here.total > WRONG and clear and order[0] != 0
    return here, best[1] if named else None, best[0]
