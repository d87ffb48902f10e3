"""The lit Gaussians as the viewer draws them: discs with colour by direction, y up."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.splats.splat_ply import read_splat_ply

from .packing import octahedral, packed

MOST = 60_000
"""Gaussians in the page: 60 bytes each; of more, every 2nd, 3rd, ... and wider in proportion."""


def splat_entry(path: Path, turn: NDArray[np.float64]) -> dict[str, Any] | None:
    """splats_lit.ply as packed arrays; None where there is none, or nothing in it. Raises UserError for a damaged one.

    turn [3, 3]: to the y-up frame. `position` uint16 over the box from `low` to `high`, `normal` octahedral, `sigma` (half
    floats in uint16), `opacity` bytes, `colour` [N, 48] int8: harmonics, the coefficients of red, green and blue by turns, over
    `range` [16] of each harmonic.
    """
    if not path.is_file():
        return None
    cloud = read_splat_ply(path).turned(turn)
    step = -(-len(cloud) // MOST)
    if not step:
        return None
    w, x, y, z = cloud.quaternions[::step].T
    normal = np.stack([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)], -1)
    means, coefficients = cloud.means[::step], cloud.coefficients[::step]
    low, high = means.min(0), means.max(0)
    most = np.maximum(np.abs(coefficients).max((0, 2)), 1e-6)
    sigma = np.exp(np.sort(cloud.log_scales[::step], axis=1)[:, 1:].mean(1)) * np.sqrt(step)
    return {
        "low": low.tolist(), "high": high.tolist(), "range": most.tolist(),
        "position": packed(np.rint((means - low) / np.maximum(high - low, 1e-30) * 65535).astype(np.uint16)),
        "normal": packed(octahedral(normal)),
        "sigma": packed(sigma.astype("<f2").view(np.uint16)),
        "opacity": packed(np.rint(255 / (1 + np.exp(-cloud.opacity[::step]))).astype(np.uint8)),
        "colour": packed(np.rint(coefficients / most[:, None] * 127).astype(np.int8).reshape(len(means), -1)),
    }  # fmt: skip
