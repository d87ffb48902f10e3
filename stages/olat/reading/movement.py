"""How one picture of an object lies off another: a shift and a turn in the image plane, and what these two leave.

Shifts are measured in tiles of the object (as `misregistration` does of the whole); the movement of a rigid picture is fitted
to them, and how far tiles are off it tells what no such movement explains: parallax, or an object that bends.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from stages.olat.reading.misregistration import best_shift, edges_of, inner_part

TILES = 3  # across and down the object
LEAST_TILE = 12  # pixels of a tile's side: its edges are found over an eighth of it at most
FEWEST = 3  # tiles that tell a turn from a shift
COVERED = 0.4  # of a tile that has to be the object's
ROUNDS, FLOOR = 5, 0.1  # of reweighting by the misfit, which is no less than a shift's own error (px)
CERTAIN = 3.0  # standard errors from which a turn is one
REFINED = 3  # times that a turn is measured again, on the picture laid back by what is known


@dataclass(frozen=True)
class Movement:
    """Of the second picture against the first.

    Fields:
        right, down: shift of the object's middle, pixels.
        turn_deg: counter-clockwise as displayed.
        furthest_px: how far the object's furthest pixel moves.
        residual_px: root mean square of what tiles are off that movement; None where too few could be measured.
        turned: whether the turn is more than chance.
    """

    right: float
    down: float
    turn_deg: float
    furthest_px: float
    residual_px: float | None
    turned: bool

    def as_json(self) -> dict[str, object]:
        """For the manifest's facts."""
        residual = None if self.residual_px is None else round(self.residual_px, 2)
        shift = [round(self.right, 2), round(self.down, 2)]
        return {"shift_px": shift, "turn_deg": round(self.turn_deg, 3), "residual_px": residual}


def movement_between(
    first: NDArray[np.float64], second: NDArray[np.float64], inside: NDArray[np.bool_], step: int = 1
) -> Movement | None:
    """Measure how the second picture lies off the first.

    Args:
        first, second: brightness, of the object in equal light. [H, W]
        inside: the object. [H, W]
        step: pixels of the frame a pixel of these stands for.

    Returns:
        The movement in pixels of the frame; None where nothing in the pictures tells.
    """
    if inside.sum() < 64:
        return None
    rows, columns = np.nonzero(inside)
    middle = np.array([columns.mean(), rows.mean()])
    reach = float(np.sqrt(((np.stack([columns, rows], -1) - middle) ** 2).sum(-1)).max())
    measured = _measured(first, second, inside, middle)
    if measured is None:
        return None
    (right, down, turn), residual, error = measured
    for _ in range(REFINED if abs(turn) > CERTAIN * error else 0):  # a tile that turns correlates less, and shows less of it
        again = _measured(first, _laid_back(second, middle, right, down, turn), inside, middle)
        if again is None:
            break
        (across, below, more), residual, error = again
        c, s = np.cos(turn), np.sin(turn)
        right, down, turn = right + c * across - s * below, down + s * across + c * below, turn + more
    turned = bool(abs(turn) > CERTAIN * error)
    furthest = float(np.hypot(right, down)) + (abs(turn) * reach if turned else 0.0)
    shift = float(right) * step, float(down) * step
    return Movement(*shift, -float(np.degrees(turn)), furthest * step, residual * step, turned)


def _measured(
    first: NDArray[np.float64], second: NDArray[np.float64], inside: NDArray[np.bool_], middle: NDArray[np.float64]
) -> tuple[NDArray[np.float64], float, float] | None:
    """(right, down, turn) about the middle, as `_rigid` has them; None where too few tiles tell."""
    found = [(place - middle, np.array(shift[::-1])) for place, shift in _tiles(first, second, inside)]
    if len(found) < FEWEST:
        return None
    places, shifts = (np.array(side) for side in zip(*found))
    return _rigid(places, shifts)


def _laid_back(
    picture: NDArray[np.float64], middle: NDArray[np.float64], right: float, down: float, turn: float
) -> NDArray[np.float64]:
    """The picture as if it had not moved, bilinear."""
    from scipy.ndimage import affine_transform

    c, s = np.cos(turn), np.sin(turn)
    matrix = np.array([[c, s], [-s, c]])  # of (row, column)
    centre, moved = middle[::-1], np.array([down, right])
    return np.asarray(affine_transform(picture, matrix, centre + moved - matrix @ centre, order=1, mode="nearest"))


def _tiles(
    first: NDArray[np.float64], second: NDArray[np.float64], inside: NDArray[np.bool_]
) -> Iterator[tuple[NDArray[np.float64], tuple[float, float]]]:
    """Middle (column, row) of each tile of the object whose shift (down, right) its edges tell, and the shift."""
    rows, columns = np.flatnonzero(inside.any(1)), np.flatnonzero(inside.any(0))
    down = np.linspace(rows[0], rows[-1] + 1, TILES + 1).round().astype(int)
    across = np.linspace(columns[0], columns[-1] + 1, TILES + 1).round().astype(int)
    if min(np.diff(down).min(), np.diff(across).min()) < LEAST_TILE:
        return
    for top, bottom in pairwise(down):
        for left, right in pairwise(across):
            cut = np.s_[top:bottom, left:right]
            own = inside[cut]
            if own.mean() < COVERED:
                continue
            shift = best_shift(edges_of(first[cut], own), edges_of(second[cut], own), inner_part(own))
            if shift != (0.0, 0.0):  # which is what it says where nothing stands out
                yield np.array([(left + right - 1) / 2, (top + bottom - 1) / 2]), shift


def _rigid(places: NDArray[np.float64], shifts: NDArray[np.float64]) -> tuple[NDArray[np.float64], float, float]:
    """(right, down, turn in radians) of shifts [N, 2] at places [N, 2] about their middle, reweighted by the misfit; the root
    mean square of the misfit, and the turn's standard error."""
    rows = np.zeros((len(places), 2, 3))
    rows[:, 0, 0] = rows[:, 1, 1] = 1.0
    rows[:, 0, 2], rows[:, 1, 2] = -places[:, 1], places[:, 0]
    weight = np.ones(len(places))
    answer, off = np.zeros(3), shifts
    for _ in range(ROUNDS):
        scale = np.sqrt(weight)[:, None]
        answer = np.linalg.lstsq((rows * scale[..., None]).reshape(-1, 3), (shifts * scale).ravel(), rcond=None)[0]
        off = shifts - rows @ answer
        weight = 1.0 / np.maximum(np.linalg.norm(off, axis=1), FLOOR)
    residual = float(np.sqrt((off**2).sum(-1).mean()))
    spread = float(np.sqrt(((places - places.mean(0)) ** 2).sum()))
    return answer, residual, max(residual, FLOOR) / max(spread, 1e-9)
