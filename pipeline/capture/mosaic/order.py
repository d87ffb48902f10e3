"""Does the specified order of a polariser mosaic fit its samples? Crossed polarisers share the light: I(t) + I(t + 90) = s0."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

PAIRINGS = {
    "diagonally": ((0, 3), (1, 2)),
    "side by side": ((0, 1), (2, 3)),
    "one above the other": ((0, 2), (1, 3)),
}
"""How the two crossed pairs can lie in a 2x2 block (places row by row)."""
TILE = 8
"""Blocks a side whose mean is taken: contents differ by a pixel's shift then, polarisation stays."""
MOST_TILES = 4096
SURE = 3.0
"""How much worse the specified pairs must fit than others. Renders of two objects: right pairs fit 3 to 10 times better."""


def order_fault(samples: NDArray[np.float32], order: Sequence[float]) -> str | None:
    """A line where pairs that are not specified as crossed (90 degrees apart) fit a mosaic [H, W] much better; else None.

    Swapping both crossed pairs, or the angles within one, cannot be seen here: the masks stage looks at the outline.
    """
    crossed = {n: all(abs((order[a] - order[b]) % 180 - 90) < 1 for a, b in pairs) for n, pairs in PAIRINGS.items()}
    stated = next((n for n, is_so in crossed.items() if is_so), None)
    imbalance = pair_imbalance(samples)
    if stated is None or imbalance is None:
        return None
    best = min(imbalance, key=lambda n: imbalance[n])
    if best == stated or imbalance[stated] < SURE * imbalance[best]:
        return None
    block = " ".join(f"{a:g}" for a in order[:2]) + " / " + " ".join(f"{a:g}" for a in order[2:])
    return f"crossed polarisers lie {best} here, not {stated} as in {block}: check that mosaic.order is that of this sensor"


def pair_imbalance(samples: NDArray[np.float32]) -> dict[str, float] | None:
    """Median |I(a) + I(b) - I(c) - I(d)| over their sum, by how the pairs lie; None where too little is lit."""
    side = 2 * TILE
    height, width = (n // side * side for n in samples.shape)
    if not height or not width:
        return None
    rows = samples[:height, :width].reshape(height // side, side, width)
    rows = rows[:: max(1, height // side * width // side // MOST_TILES)]
    places = [
        rows[:, j::2, i::2].reshape(len(rows), TILE, width // side, TILE).mean((1, 3)) for j in range(2) for i in range(2)
    ]
    total = np.sum(places, axis=0)
    lit = total > 0.05 * np.percentile(total, 99)
    if lit.sum() < 4:
        return None
    return {
        name: float(np.median(np.abs(places[a] + places[b] - places[c] - places[d])[lit] / total[lit]))
        for name, ((a, b), (c, d)) in PAIRINGS.items()
    }
