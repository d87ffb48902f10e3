"""A view's diffuse and specular parts against those of gt/material/VIEW.exr."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pipeline.formats.gbuffer import PARTS, part_of
from pipeline.formats.images import RGB, channel_names, read_image, srgb_encode

from .image_figures import psnr

FIGURES = tuple(f"psnr_{part}" for part in PARTS)


def part_figures(path: Path, channels: Mapping[str, NDArray], inside: NDArray[np.bool_]) -> dict[str, float]:
    """PSNR (dB, sRGB-encoded) of each part of the radiance s0 over the object's pixels.

    Args:
        path: gt/material/VIEW.exr; a part counts where it has PART.R, PART.G and PART.B.
        channels: the model's test view. [H, W] by name
        inside: pixels that the object covers wholly. [H, W]

    Returns:
        psnr_diffuse and psnr_specular, as far as there is truth of the view's size.
    """
    told, out = set(channel_names(path)), {}
    for name, part in zip(FIGURES, PARTS):
        names = tuple(f"{part}.{c}" for c in RGB)
        if not told.issuperset(names) or f"{part}.R" not in channels:
            continue
        true = read_image(path, names)
        if true.shape[:2] == inside.shape and inside.any():
            out[name] = psnr(srgb_encode(part_of(channels, part)), srgb_encode(true), inside)
    return out
