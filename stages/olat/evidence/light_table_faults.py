"""Faults that a light table shows by itself: lights that repeat, or lie so close together that they tell too little."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pipeline.capture.naming.files import some
from pipeline.rig.light_table import LightTable

SAME_RAD = 1e-4  # between two lights of one place: tables are printed with four digits or more
UNIT = 1e-3
"""By how much lengths of directions are off 1."""
NARROW = 5.0
"""Condition number of the lights' directions from which noise across them is amplified that much: 1 all around, 3 for lights
within 35 degrees of their middle, 5 within 22 degrees, endless in one plane."""


def spread(directions: NDArray[np.float64]) -> float:
    """Condition number of unit directions [N, 3]: by how much more noise one direction of a normal has than another."""
    values = np.linalg.svd(directions, compute_uv=False)
    return float(values[0] / values[2]) if len(values) == 3 and values[2] > 1e-12 * values[0] else np.inf


def repeated(places: NDArray[np.float64]) -> list[tuple[int, int]]:
    """Pairs of lights at one place [N, 3] (unit directions, or positions over their size)."""
    found = []
    for k in range(len(places) - 1):
        off = np.abs(places[k + 1 :] - places[k]).max(1)
        found += [(k, k + 1 + int(j)) for j in np.flatnonzero(off < SAME_RAD)]
    return found


def table_faults(lights: LightTable, near: bool) -> tuple[str | None, list[str]]:
    """(a fault that leaves nothing to fit, or None; doubts that are worth a line) of a light table."""
    direction = lights.directions
    size = float(np.median(np.linalg.norm(lights.positions, axis=1)))
    pairs = repeated(lights.positions / size if near else direction)
    condition = spread(direction)
    if np.all(np.linalg.norm(direction - direction[0], axis=1) < SAME_RAD):
        return f"all {len(lights)} lights lie in one direction, which tells no normal", []
    doubts = []
    if near and np.allclose(np.linalg.norm(lights.positions, axis=1), 1, atol=UNIT):
        doubts.append(
            "every light is 1 world unit from the stage's centre, as directions are, but olat.near_light = true takes them for "
            "places: give the lights' positions in world units, or take near_light out"
        )
    if pairs:
        named = some(f"{a + 1} and {b + 1}" for a, b in pairs)
        doubts.append(
            f"{len({k for pair in pairs for k in pair})} of {len(lights)} lights share their place with another ({named}): "
            "is a line repeated? Give every light its own direction"
        )
    if condition > NARROW:
        what = "in one plane with the stage's centre" if condition > 1e3 else "on one side, close together"
        amount = "" if condition > 1e3 else f": noise counts {condition:.0f} times across them"
        doubts.append(
            f"the lights lie {what}{amount}; normals and widths are determined poorly or not at all (flags 1 and 7): "
            "spread the lights, or check the table"
        )
    return None, doubts
