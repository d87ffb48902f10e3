"""Textures as files: 16-bit PNG for programs that filter integers, EXR for those that take floats."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pipeline.formats.images import RGB, srgb_encode, write_exr, write_png

COLOURS = ("albedo", "base_color")
"""Encoded as sRGB in PNG; every other map is linear there. EXR holds all as they are."""
DIRECTIONS = ("normal", "tangent")
"""In PNG about a half."""
IOR_SPAN = (1.0, 3.0)
"""What 0 and 1 mean in ior.png."""
DEGREES = 180.0
"""What 1 means in std_diffuse_normal.png; other maps above 1 end there in PNG."""


def write_textures(folder: Path, maps: dict[str, NDArray[np.float32]]) -> list[str]:
    """Write NAME.png (16 bits) and NAME.exr of every map [H, W, 1 or 3]; and normal_map.exr, normals about a half as in PNG.

    Maps of two channels are for formats that pack them. Returns the names, sorted. Raises UserError.
    """
    folder.mkdir(parents=True, exist_ok=True)
    written = {name: image for name, image in sorted(maps.items()) if image.shape[-1] != 2}
    for name, image in written.items():
        write_png(folder / f"{name}.png", encoded(name, image), bits=16)
        channels = ("Y",) if image.shape[-1] == 1 else RGB
        write_exr(folder / f"{name}.exr", {c: image[..., k] for k, c in enumerate(channels)}, half=name != "ior")
    upright = encoded("normal", maps["normal"])
    write_exr(folder / "normal_map.exr", {c: upright[..., k] for k, c in enumerate(RGB)}, half=True)
    return list(written)


def encoded(name: str, image: NDArray[np.float32]) -> NDArray[np.float32]:
    """A map [H, W, C] as an integer picture shows it, in 0..1: colours sRGB, directions about a half, ior over IOR_SPAN."""
    if name in COLOURS:
        return srgb_encode(image)
    if name == "std_diffuse_normal":
        return image / np.float32(DEGREES)
    if name in DIRECTIONS:
        return image * np.float32(0.5) + np.float32(0.5)
    if name == "ior":
        low, high = IOR_SPAN
        return (image - np.float32(low)) / np.float32(high - low)
    return image
