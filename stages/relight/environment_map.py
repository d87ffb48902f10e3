"""Environment maps as the user gives them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import UserError
from pipeline.formats.images import RGB, read_image


def read_map(path: Path) -> tuple[NDArray[np.float32], list[str]]:
    """Read an environment map of the user's.

    Args:
        path: a latitude-longitude image.

    Returns:
        Linear radiance, finite and >= 0 [H, W, 3], and what had to be mended.

    Raises:
        UserError: it cannot be read, or is not twice as wide as high.
    """
    pixels = read_image(path)
    pixels = np.repeat(pixels[..., :1], 3, -1) if pixels.shape[-1] < 3 else read_image(path, RGB)
    height, width = pixels.shape[:2]
    if width != 2 * height:
        fault = f"is {width}x{height}: a latitude-longitude map is twice as wide as high"
        raise UserError(path, fault, "convert it to that projection")
    faults = []
    for what, bad in (("not finite", ~np.isfinite(pixels)), ("negative", pixels < 0)):
        if bad.any():
            count = int(bad.any(-1).sum())
            faults.append(f"{path.name}: {count} pixels are {what} and taken as 0; check how the map was written")
            pixels = np.where(bad, 0, pixels)
    if not pixels.any():
        faults.append(f"{path.name}: the map is black; check the file")
    return np.ascontiguousarray(pixels, np.float32), faults
