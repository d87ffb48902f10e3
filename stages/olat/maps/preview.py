"""One picture of a camera's maps for a person to judge."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pipeline.formats.images import srgb_encode, write_png
from stages.olat.pixel_fit.result_layout import columns

GRID = (
    ("diffuse_albedo", "specular_albedo", "diffuse_normal", "specular_normal", "normal", "tangent"),
    ("sigma", "anisotropy", "occlusion_d", "interreflection_d", "residual", "flag"),
)
FLAG_COLOURS = np.array(
    [[0.1, 0.35, 0.15], [0.9, 0.7, 0.1], [0.95, 0.3, 0.2], [0, 0, 0], [0.3, 0.4, 0.9], [0.9, 0.2, 0.9], [0.87, 0.42, 0.13],
     [0.2, 0.6, 0.58]]
)  # fmt: skip


def write_preview(path: Path, maps: NDArray[np.float32]) -> None:
    """Write the maps [H, W, WIDTH] (subsampled) as a grid, cropped to the object, numbers scaled to the 98th percentile."""
    inside = np.linalg.norm(maps[..., columns()["normal"]], axis=-1) > 0
    if inside.any():
        rows, cols = np.flatnonzero(inside.any(1)), np.flatnonzero(inside.any(0))
        crop = slice(rows[0], rows[-1] + 1), slice(cols[0], cols[-1] + 1)
        maps, inside = maps[crop], inside[crop]
    zoom = max(1, 160 // max(maps.shape[:2]))
    tiles = [np.concatenate([_tile(maps, inside, name) for name in row], 1) for row in GRID]
    grid = np.concatenate(tiles, 0)
    write_png(path, np.repeat(np.repeat(grid, zoom, 0), zoom, 1))


def _tile(maps: NDArray[np.float32], inside: NDArray[np.bool_], name: str) -> NDArray[np.float32]:
    place = columns()
    values = maps[..., place["residual"]][..., 1:] if name == "flag" else maps[..., place[name]]
    if name == "residual":
        values = values[..., :1]
    if name == "flag":
        colour = FLAG_COLOURS[np.clip(values[..., 0].astype(int), 0, len(FLAG_COLOURS) - 1)]
    elif name.endswith("normal"):
        colour = 0.5 + 0.5 * values
    elif name == "tangent":
        colour = np.abs(values)
    else:
        top = float(np.percentile(values[inside], 98)) if inside.any() else 1.0
        scaled = values / max(top, 1e-6)
        if name == "sigma":
            scaled = np.concatenate([scaled, np.zeros_like(scaled[..., :1])], -1)
        colour = srgb_encode(scaled) if name.endswith(("albedo", "_d")) else np.clip(scaled, 0, 1)
    colour = np.broadcast_to(colour, (*colour.shape[:2], 3)) if colour.shape[2] == 1 else colour
    return np.pad(np.where(inside[..., None], colour, 0.0).astype(np.float32), ((1, 1), (1, 1), (0, 0)))
