"""Do these pictures show one framing under changing light, and not views of an object? Decided by a look at a dozen of them.

Under a fixed camera and a moving light a matt picture is albedo times shading, and shading is linear in the light: about
three pictures explain all (Shashua 1997; Basri & Jacobs, PAMI 2003), and from one picture to the next a small piece
becomes brighter or darker but does not move. Where camera or object move, many pictures are needed to explain the rest,
and a piece's change is better explained by a shift than by a gain. A polariser that turns, or an exposure that is bracketed,
keeps the framing too, but changes light by less or everywhere alike.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from pipeline.capture.naming.files import RAW_SUFFIXES
from pipeline.capture.pixels.raw import raw_preview
from pipeline.capture.recognition.still_detail import still_detail
from pipeline.errors import UserError
from pipeline.formats.image_parts import without_alpha
from pipeline.formats.images import image_size, read_stored, srgb_decode

Plane = NDArray[np.float64]
LOOKED_AT, FEWEST = 12, 6
"""Pictures that are read at most, and at least: fewer explain each other whatever they show."""
SIDE = 192
"""Longest side (pixels) of what is compared."""
OVERSAMPLED = 4
"""Samples a side for each pixel of that, at least, where the picture has them."""
CHANGING = 0.1
"""Of its mean, the deviation of a pixel (exposures made equal) above which it changes."""
EXPLAINED = 0.88
"""Share of the change that three pictures explain, for as many pictures as there are. Measured on one framing: 0.98 (eight
lights, real), 0.96, 0.94 and 0.93 (rendered light stages, cross pass), 0.91 to 0.99 (rendered, six and twelve lights, shadows
on half of the object), 0.89 (lights all around); on views: 0.48 to 0.56 (six captures), 0.84 at most (a textured ball, whose
outline never changes). An even ball seen from around cannot be told from one lit from around, nor can COLMAP place it."""
IN_PLACE = 0.55
"""Most of what a gain leaves of a piece's change over what a shift leaves. One framing: 0.05 to 0.38; small movements, which
three pictures explain too: 0.77 to 2.9."""
STRONG = 0.32
"""Deviation of what changes, over its mean (median): the eight real lights 0.34, others 0.4 to 1.7; a polariser that turns
changes light of DoLP d by 0.7 d."""
FEWEST_BLOCKS = 8
STILL = 0.35
"""Share of the detail that is found in its place in another picture. Lights from the front: 0.79 to 0.95 (rendered, eight real
ones), from all around 0.18 to 0.47; views: 0.00 to 0.10 (five captures), 0.16 (an ellipsoid, whose outline hardly changes)."""
LEFT = 0.05
"""Share of the structure within pieces that no gain explains. A polariser that turns, and exposures that clip: 0.001 to 0.025;
a turn of the object by 5 degrees: 0.08 and more (a textured ball at 48 and 96 pixels)."""


@dataclass(frozen=True)
class Framing:
    """Figures of a set of pictures: see the limits of the same names."""

    explained: float
    in_place: float
    strength: float
    blocks: int

    @property
    def is_one(self) -> bool:
        """Whether they are one framing under changing light."""
        sure = self.blocks >= FEWEST_BLOCKS and self.strength >= STRONG
        return sure and self.explained >= EXPLAINED and self.in_place <= IN_PLACE


def changes_light(paths: Sequence[Path]) -> bool:
    """Whether the pictures show one framing, or one a folder (a camera's, a pass's), under changing light."""
    folders: dict[Path, list[Path]] = defaultdict(list)
    for path in paths:
        folders[path.parent].append(path)
    largest = sorted(folders.values(), key=len, reverse=True)[:2]
    return one_framing(paths) or (len(folders) > 1 and all(one_framing(found) for found in largest))


def one_framing(paths: Sequence[Path]) -> bool:
    """Whether the pictures `paths`, one a view, show one framing under changing light; files that cannot be read: no."""
    pictures = _some_small(paths) if len(paths) >= FEWEST else None
    found = framing(pictures) if pictures is not None else None
    return found is not None and found.is_one


def moves(paths: Sequence[Path]) -> bool:
    """Whether detail of the pictures is not found in its place in the others. Files that cannot be read, or show none: no."""
    pictures = _some_small(paths)
    still = None if pictures is None else still_detail(pictures)
    return still is not None and still < STILL


def what_changes(paths: Sequence[Path]) -> Literal["gain", "light"] | None:
    """What changes between pictures, however few, if they show one framing: the gain of each piece, as of a polariser or an
    exposure; or the light. None where things move or hardly differ, and of files that cannot be read."""
    pictures = _some_small(paths)
    if pictures is None:
        return None
    mean = np.asarray(pictures.mean(0))
    lit = mean > 0.02 * np.percentile(mean, 99)
    in_place, blocks = _gain_over_shift(pictures, mean, lit)
    if blocks < FEWEST_BLOCKS or in_place > IN_PLACE or not (pictures != pictures[0]).any():
        return None
    if _left_by_gain(pictures, mean, lit) <= LEFT:
        return "gain"
    if (still_detail(pictures) or 0) < STILL:
        return None
    equal = pictures / np.maximum(pictures[:, lit].mean(1), 1e-6)[:, None, None]
    deviation = equal.std(0) / np.maximum(equal.mean(0), 1e-6)
    changes = lit & (deviation > CHANGING)
    return "light" if changes.any() and np.median(deviation[changes]) >= STRONG else "gain"


def _some_small(paths: Sequence[Path]) -> Plane | None:
    """A dozen of the pictures [n, H, W], small and grey; None where they cannot be read or are of several sizes."""
    chosen = [paths[k * len(paths) // min(LOOKED_AT, len(paths))] for k in range(min(LOOKED_AT, len(paths)))]
    try:
        if len({image_size(p) for p in chosen}) > 1:
            return None
        return np.stack([_small_grey(p) for p in chosen])
    except UserError:  # raw or damaged: the reader says so
        return None


def framing(pictures: Plane) -> Framing | None:
    """The figures of pictures [n, H, W] (linear, grey); None where hardly anything changes."""
    bright = np.percentile(pictures, 99.5)
    if not bright > 0:
        return None
    pictures = np.minimum(pictures / bright, 2.0)
    mean = np.asarray(pictures.mean(0))
    lit = mean > 0.02 * np.percentile(mean, 99)
    exposure = pictures[:, lit].mean(1)
    equal = pictures / np.maximum(exposure, 1e-6)[:, None, None]
    deviation = equal.std(0) / np.maximum(equal.mean(0), 1e-6)
    changes = lit & (deviation > CHANGING)
    if changes.sum() < 16:
        return None
    part = pictures[:, changes]
    values = np.linalg.svd(part - part.mean(0), compute_uv=False) ** 2
    n = len(pictures)
    left = values[3:].sum() / max(values.sum(), 1e-12) * (n - 1) / (n - 4)  # three of n - 1 explain as much of noise
    in_place, blocks = _gain_over_shift(pictures, mean, changes)
    return Framing(float(1 - left), in_place, float(np.median(deviation[changes])), blocks)


def _gain_over_shift(pictures: Plane, mean: Plane, changes: NDArray[np.bool_]) -> tuple[float, int]:
    """What a gain of each block leaves of its change, over what a shift (by the gradient) leaves; and the blocks."""
    side = 8 if max(mean.shape) >= 96 else 4
    down, along = np.gradient(_smoothed(mean))
    whole = _blocks(changes.astype(float), side).mean(1) > 0.9
    base, dy, dx = (_blocks(np.asarray(a, np.float64), side)[whole] for a in (mean, down, along))
    if not whole.any():
        return np.inf, 0
    xx, xy, yy = (dx * dx).sum(1), (dx * dy).sum(1), (dy * dy).sum(1)
    determinant = xx * yy - xy**2 + 1e-12
    by_gain = by_shift = 0.0
    for picture in pictures:
        change = _blocks(picture - mean, side)[whole]
        gain = (change * base).sum(1) / np.maximum((base * base).sum(1), 1e-12)
        by_gain += float(((change - gain[:, None] * base) ** 2).sum())
        px, py = (dx * change).sum(1), (dy * change).sum(1)
        sx, sy = (yy * px - xy * py) / determinant, (xx * py - xy * px) / determinant
        by_shift += float(((change - sx[:, None] * dx - sy[:, None] * dy) ** 2).sum())
    return by_gain / max(by_shift, 1e-12), int(whole.sum())


def _left_by_gain(pictures: Plane, mean: Plane, lit: NDArray[np.bool_]) -> float:
    """What a gain leaves of each block's own structure, over that structure."""
    side = 8 if max(mean.shape) >= 96 else 4
    whole = _blocks(lit.astype(float), side).mean(1) > 0.9
    base = _blocks(mean, side)[whole]
    left = structure = 0.0
    for picture in pictures:
        part = _blocks(picture, side)[whole]
        gain = (part * base).sum(1) / np.maximum((base * base).sum(1), 1e-12)
        left += float(((part - gain[:, None] * base) ** 2).sum())
        structure += float(((part - part.mean(1, keepdims=True)) ** 2).sum())
    return left / max(structure, 1e-12)


def _blocks(image: Plane, side: int) -> Plane:
    """Pieces [blocks, side * side] of an image [H, W], which is cut to whole ones."""
    rows, columns = image.shape[0] // side, image.shape[1] // side
    cut = image[: rows * side, : columns * side].reshape(rows, side, columns, side)
    return cut.swapaxes(1, 2).reshape(-1, side * side)


def _smoothed(image: Plane) -> Plane:
    from scipy.ndimage import gaussian_filter

    return np.asarray(gaussian_filter(image, 0.7))


def _small_grey(path: Path) -> Plane:
    """A picture [h, w] in linear light, grey, its longest side at most SIDE. Raises UserError."""
    import cv2

    pixels, names, kind = _pixels(path)
    colours = without_alpha(names)[:3]
    step = max(1, max(pixels.shape[:2]) // (SIDE * OVERSAMPLED)) | 1  # odd: all polarisers of a mosaic have a part
    grey = np.nan_to_num(pixels[::step, ::step, colours].mean(-1, dtype=np.float64), posinf=0.0, neginf=0.0)
    grey = srgb_decode(np.clip(grey, 0, 1)) if kind == "uint8" else np.maximum(grey, 0)
    scale = SIDE / max(grey.shape)
    if scale < 1:
        grey = cv2.resize(grey, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    return np.asarray(grey, np.float64)


def _pixels(path: Path) -> tuple[NDArray[np.float32], list[str], str]:
    """Pixels [H, W, C] of a picture, its channels and kind; a JPEG at the eighth or quarter that it decodes to at once."""
    suffix = path.suffix.lower()
    if suffix in RAW_SUFFIXES:
        return raw_preview(path), ["R", "G", "B"], "uint8"
    if suffix not in (".jpg", ".jpeg"):
        return read_stored(path)
    from PIL import Image

    try:
        with Image.open(path) as image:
            image.draft("L", (SIDE, SIDE))
            grey = np.asarray(image.convert("L"), np.float32)
    except (OSError, ValueError, SyntaxError) as error:
        raise UserError(path, f"cannot be read as an image ({error})", "copy it again or remove it") from None
    return grey[..., None] / np.float32(255), ["Y"], "uint8"
