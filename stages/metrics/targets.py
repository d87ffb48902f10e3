"""What test views should look like."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pipeline.formats import dataset_files as files
from pipeline.formats.backdrop import object_pixels
from pipeline.formats.images import RGB, channel_names, image_size, read_image, read_stokes


@dataclass(frozen=True)
class Target:
    """What a test view should look like: `stokes` [H, W, 3, 3] or `rgb` [H, W, 3], black where nothing is compared.

    inside: wholly covered pixels [H, W]; compared: those that hold the object's light [H, W], all where not told.
    """

    stokes: NDArray[np.float32] | None
    rgb: NDArray[np.float32]
    inside: NDArray[np.bool_] | None
    compared: NDArray[np.bool_]


def read_target(decode: Path, masks: Path | None, view: str) -> Target:
    """A view as decoded, without its background. Raises UserError."""
    path = files.frame(decode, view)
    stokes = read_stokes(path) if "S1.R" in channel_names(path) else None
    rgb = read_image(path, RGB) if stokes is None else stokes[:, :, 0]
    inside, compared = None, np.ones(rgb.shape[:2], bool)
    mask_path = files.mask(masks, view) if masks else None
    if mask_path is not None and mask_path.exists() and image_size(mask_path) == image_size(path):
        share = read_image(mask_path)[..., 0]
        inside, compared = share > 0.99, object_pixels(rgb, share > 0)
    rgb = rgb * compared[..., None]
    return Target(None if stokes is None else stokes * compared[..., None, None], rgb, inside, compared)
