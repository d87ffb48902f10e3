"""Textures as files: 16-bit PNG for programs that filter integers, EXR for those that take floats."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pipeline.formats.images import RGB, srgb_encode, write_exr, write_png

COLOURS = ("albedo", "base_color")
"""Encoded as sRGB in PNG; every other map is linear there. EXR holds all as they are."""
IOR_SPAN = (1.0, 3.0)
"""What 0 and 1 mean in ior.png."""


def write_textures(folder: Path, maps: dict[str, NDArray[np.float32]]) -> list[str]:
    """Write NAME.png (16 bits) and NAME.exr of every map [H, W, C]; and normal_map.exr, normals about a half as in PNG.

    Returns the names, sorted. Raises UserError.
    """
    folder.mkdir(parents=True, exist_ok=True)
    for name, image in sorted(maps.items()):
        write_png(folder / f"{name}.png", encoded(name, image), bits=16)
        channels = ("Y",) if image.shape[-1] == 1 else RGB
        write_exr(folder / f"{name}.exr", {c: image[..., k] for k, c in enumerate(channels)}, half=name != "ior")
    upright = encoded("normal", maps["normal"])
    write_exr(folder / "normal_map.exr", {c: upright[..., k] for k, c in enumerate(RGB)}, half=True)
    return sorted(maps)


def encoded(name: str, image: NDArray[np.float32]) -> NDArray[np.float32]:
    """A map [H, W, C] as an integer picture shows it, in 0..1: colours sRGB, normals about a half, ior over IOR_SPAN."""
    if name in COLOURS:
        return srgb_encode(image)
    if name == "normal":
        return image * np.float32(0.5) + np.float32(0.5)
    if name == "ior":
        low, high = IOR_SPAN
        return (image - np.float32(low)) / np.float32(high - low)
    return image
