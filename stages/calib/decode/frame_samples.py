"""A light-stage frame's samples: all of them, and of a large frame those of every fourth chunk of scanlines.

The paper's capture, eight cameras of 20 megapixels under 346 lights, has 5536 frames: to read them whole takes longer than the
fits. What is asked here (is the frame black, where is it clipped, are its samples finite) a quarter of the rows tells.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import UserError
from pipeline.formats.exr_frame import exr_frame
from pipeline.formats.images import open_image, read_stored, reason_of

LARGE = 1 << 23  # pixels: smaller frames are read whole
ROWS, EVERY = 16, 4  # scanlines that EXR's zip compresses together; of these chunks each fourth is read


def frame_samples(path: Path) -> tuple[NDArray[np.float32], tuple[int, int]]:
    """Samples [H, W, C] of the picture's R, G, B (fewer rows of a large frame), and the frame's (width, height).

    Raises UserError on a frame that is missing or damaged.
    """
    image = open_image(path, plain=True)
    spec = image.spec()
    frame = exr_frame(spec, path)
    whole = not frame.is_plain or spec.x or spec.y or spec.tile_width or spec.width * spec.height <= LARGE
    if whole:
        image.close()
        pixels, names, _ = read_stored(path, plain=True)
        size = pixels.shape[1], pixels.shape[0]
    else:
        tops = range(0, spec.height, ROWS * EVERY)
        parts = [image.read_scanlines(t, min(t + ROWS, spec.height), 0, 0, spec.nchannels, "float") for t in tops]
        error = reason_of(image) if any(part is None for part in parts) else ""
        image.close()
        if error:
            raise UserError(path, f"the image is truncated or corrupt ({error})", "copy it again from its source")
        pixels = np.concatenate([np.asarray(part, np.float32).reshape(-1, spec.width, spec.nchannels) for part in parts])
        names, size = list(spec.channelnames), frame.size
    lower = [name.lower() for name in names]
    if len(lower) > 3 and {"r", "g", "b"} <= set(lower):
        pixels = pixels[..., [lower.index(c) for c in "rgb"]]
    return pixels, size
