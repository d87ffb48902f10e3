"""Masks that came with the capture: what their values mean, and whether they say anything."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pipeline.formats.images import read_image

THRESHOLD = 127
WHOLE = 0.998  # share of the frame from which a mask tells no object from anything
LABELS = 8  # values of an integer mask up to which they are labels, not shades
LEAST = 4  # pixels of two values only that make a mask of them; fewer are the remains of one edge


@dataclass(frozen=True)
class GivenMask:
    """A mask that came with the capture.

    Fields:
        pixels: 8 bits, above `THRESHOLD` is object. [H, W]
        reading: what was made of unusual values, for people; None: taken as they are.
    """

    pixels: NDArray[np.uint8]
    reading: str | None = None

    @property
    def inside(self) -> NDArray[np.bool_]:
        """Where the object is [H, W]."""
        return self.pixels > THRESHOLD

    @property
    def empty(self) -> bool:
        """Whether it shows no object."""
        return not self.inside.any()

    @property
    def whole(self) -> bool:
        """Whether it is white all over, which tells nothing."""
        return bool(self.inside.mean() > WHOLE)


def read_given(path: Path) -> GivenMask:
    """Read a mask file that came with the capture.

    The first channel counts, or the one that holds the mask (alpha); values 0 and 1, and labels, become 0 and 255.

    Args:
        path: the image.

    Returns:
        The mask, and what was made of its values.

    Raises:
        UserError: the file cannot be read.
    """
    image = np.clip(np.nan_to_num(read_image(path)), 0, 1)
    channel, where = _channel(image)
    mask = np.round(channel * 255).astype(np.uint8)
    if (mask > THRESHOLD).any():
        return GivenMask(mask, where)
    values = np.unique(channel)
    steps = 65535.0 if np.any(np.abs(values * 255 - np.round(values * 255)) > 1e-3) else 255.0
    labels = len(values) > 1 and values[0] == 0 and values[-1] * steps <= LABELS + 0.5
    if labels or (len(values) == 2 and (channel == values[1]).sum() >= LEAST):
        shown = ", ".join(f"{v * steps:.0f}" for v in values[:3]) + (", ..." if len(values) > 3 else "")
        lifted = np.where(channel > values[0], np.uint8(255), np.uint8(0))
        return GivenMask(lifted, f"its values are {shown}: all but the first are taken for object")
    return GivenMask(mask, where)


def _channel(image: NDArray[np.float32]) -> tuple[NDArray[np.float32], str | None]:
    """The channel [H, W] of [H, W, C] that holds the mask, and a word where it is not the first.

    An alpha that divides the frame otherwise than the first channel does is the mask: the rest then is a picture, cut out.
    """
    first = image[..., 0]
    if image.shape[2] in (2, 4):
        alpha = image[..., -1]
        if _divides(alpha) and np.any((alpha > THRESHOLD / 255) != (first > THRESHOLD / 255)):
            return alpha, "it is taken from the alpha channel"
    if _divides(first):
        return first, None
    colours = image[..., :3].max(-1) if image.shape[2] >= 3 else first
    if not (first > THRESHOLD / 255).any() and (colours > THRESHOLD / 255).any():
        return colours, "it is taken from the brightest channel"
    return first, None


def _divides(channel: NDArray[np.float32]) -> bool:
    """Whether some of it is object, and some is not."""
    inside = channel > THRESHOLD / 255
    return bool(inside.any() and not inside.all())
