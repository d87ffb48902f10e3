"""A printed label: lines of letters from large to small, dark on paper, with the vase's glaze around it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .shape import glaze

PAPER, INK = np.array([0.78, 0.74, 0.62]), np.array([0.05, 0.06, 0.09])
LINES = ("POLARFIELD", "vase no. 27", "fired at 1060 degrees", "wash by hand only, keep dry")
LABEL = (0.17, 0.48)
"""The label's first and last row over the texture's height: the vase's belly."""
AROUND = 4
"""Copies around the vase, so that every camera sees one."""


def printed(height: int = 1024) -> NDArray[np.float32]:
    """Compute a printed vase's albedo, as `glaze` does.

    Args:
        height: texels; the width is twice that.

    Returns:
        Linear RGB. [height, 2 height, 3]
    """
    from PIL import Image, ImageDraw, ImageFont

    first, last = (round(share * height) for share in LABEL)
    rows, columns = last - first, 2 * height // AROUND
    paper = Image.new("L", (columns, rows), 0)
    draw = ImageDraw.Draw(paper)
    top = 0.04 * rows
    for line in LINES:
        font = ImageFont.load_default(1)
        widest = 0.8 * columns / max(draw.textlength(line, font.font_variant(size=100)), 1)
        size = min(100 * widest, 0.3 * rows)
        draw.text((columns / 2, top), line, fill=255, font=font.font_variant(size=size), anchor="ma")
        top += 1.15 * size
    ink = (np.asarray(paper, np.float32) / 255)[..., None]
    label = PAPER * (1 - ink) + INK * ink
    out = glaze(height)
    out[first:last] = np.tile(label[::-1], (1, AROUND, 1))  # v runs from the foot up
    return out.astype(np.float32)
