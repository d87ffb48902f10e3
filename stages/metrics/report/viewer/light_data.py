"""Environments and the split-sum table as the viewer takes them."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.formats.images import RGB, read_image
from pipeline.optics.sphere import latlong_solid_angles
from pipeline.shading import splitsum

from .packing import packed, rgbe

ROWS = 128
"""Of a map in the page: 1.4 degrees, as the viewer's finest level."""


def shrunk(radiance: NDArray, rows: int = ROWS) -> NDArray[np.float64]:
    """A latitude-longitude map [H, W, 3] of at most `rows` rows, each pixel the mean radiance over its solid angle."""
    height, width, _ = radiance.shape
    if height <= rows:
        return np.asarray(radiance, float)
    across = _shares(height, rows) * latlong_solid_angles(height, width)
    along = _shares(width, 2 * rows)
    light = np.einsum("rh,hwc->rwc", across, radiance, optimize=True)
    light = np.einsum("rwc,qw->rqc", light, along, optimize=True)
    return light / (across.sum(1)[:, None, None] * along.sum(1)[None, :, None])


def _shares(count: int, fewer: int) -> NDArray[np.float64]:
    """Share [fewer, count] of each of `count` equal pieces of a line in each of `fewer`."""
    start = np.arange(fewer)[:, None] * (count / fewer)
    piece = np.arange(count)[None]
    return np.clip(np.minimum(start + count / fewer, piece + 1) - np.maximum(start, piece), 0, 1)


def light_entry(name: str, title: str, radiance: NDArray) -> dict[str, Any]:
    """One map of the viewer's list."""
    clean = np.nan_to_num(np.maximum(radiance, 0), posinf=0.0)
    return {"name": name, "title": title, "pixels": packed(rgbe(shrunk(clean)))}


def light_entries(fitted: Path, maps: Mapping[str, Path]) -> list[dict[str, Any]]:
    """The captured light first, then the maps by name, then a light that is the same from everywhere."""
    out = []
    if fitted.is_file():
        out.append(light_entry("captured", "captured light (fitted)", read_image(fitted, RGB)))
    out += [light_entry(name, name, _rgb(path)) for name, path in maps.items() if path.is_file()]
    return [*out, light_entry("even", "even light", np.ones((8, 16, 3)))]


def _rgb(path: Path) -> NDArray:
    pixels = read_image(path)
    return read_image(path, RGB) if pixels.shape[-1] >= 3 else np.repeat(pixels[..., :1], 3, -1)


def mirror_table(lobe: str) -> dict[str, Any]:
    """`splitsum.exact_table` [eta, roughness, sqrt cosine, 2] as half floats in uint16."""
    return packed(splitsum.exact_table(lobe).astype("<f2").view(np.uint16))
