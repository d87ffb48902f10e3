"""Arrays as pictures in a page: display encodings, colour scales, base64 PNG."""

from __future__ import annotations

import base64
import io
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from pipeline.formats.images import srgb_encode
from pipeline.optics.stokes import angle, degree

DOLP_FULL = 0.6  # DoLP at the bright end of its colour scale
DARK = 1e-3  # s0 below which no polarisation is shown
AOLP_FULL = 0.15  # DoLP from which an angle is shown at full brightness
# Anchor colours (sRGB) of two perceptually even scales, dark to light.
INFERNO = (
    (0, 0, 4),
    (40, 11, 84),
    (101, 21, 110),
    (159, 42, 99),
    (212, 72, 66),
    (245, 125, 21),
    (250, 193, 39),
    (252, 255, 164),
)
VIRIDIS = (
    (68, 1, 84),
    (70, 50, 127),
    (54, 92, 141),
    (39, 127, 142),
    (31, 161, 135),
    (74, 194, 109),
    (159, 218, 58),
    (253, 231, 37),
)


def radiance(linear: NDArray, exposure: float = 1.0) -> NDArray[np.uint8]:
    """Show linear light as sRGB.

    Args:
        linear: RGB, NaN as 0. [H, W, 3]
        exposure: factor before encoding.

    Returns:
        RGB bytes, clipped. [H, W, 3]
    """
    return to_bytes(srgb_encode(np.nan_to_num(linear) * exposure))


def normals(normal: NDArray) -> NDArray[np.uint8]:
    """Show normals as colours, (n + 1) / 2.

    Args:
        normal: unit, 0 where there is none. [H, W, 3]

    Returns:
        RGB bytes, black where there is none. [H, W, 3]
    """
    there = np.linalg.norm(normal, axis=-1, keepdims=True) > 0.5
    return to_bytes(np.where(there, normal * 0.5 + 0.5, 0))


def scale(values: NDArray, low: float, high: float, anchors: tuple = INFERNO, mask: NDArray | None = None) -> NDArray[np.uint8]:
    """Show numbers on a colour scale.

    Args:
        values: NaN as 0. [H, W]
        low, high: ends of the scale; what lies beyond is clipped.
        anchors: RGB 0..255, evenly spaced from low to high.
        mask: black outside; None: no mask. [H, W]

    Returns:
        RGB bytes. [H, W, 3]
    """
    share = np.clip((np.nan_to_num(values) - low) / (high - low), 0, 1)
    at = np.linspace(0, 1, len(anchors))
    colour = np.stack([np.interp(share, at, [a[k] for a in anchors]) for k in range(3)], -1)
    return (colour if mask is None else colour * mask[..., None]).round().astype(np.uint8)


def angles(angle: NDArray, strength: NDArray) -> NDArray[np.uint8]:
    """Show angles modulo pi as hues.

    Args:
        angle: radians. [H, W]
        strength: 0..1, 0 is black. [H, W]

    Returns:
        RGB bytes. [H, W, 3]
    """
    phase = 2 * angle[..., None] + np.array([0.0, 2 * np.pi / 3, 4 * np.pi / 3])
    return to_bytes((0.55 + 0.45 * np.cos(phase)) * np.clip(strength, 0, 1)[..., None])


def to_bytes(display: NDArray) -> NDArray[np.uint8]:
    """Round display values to bytes.

    Args:
        display: clipped to 0..1. [...]

    Returns:
        0..255. [...]
    """
    return (np.clip(display, 0, 1) * 255 + 0.5).astype(np.uint8)


def fit(pixels: NDArray[np.uint8], longest: int) -> NDArray[np.uint8]:
    """Shrink a picture to a largest side; it is never enlarged.

    Args:
        pixels: bytes. [H, W, 3]
        longest: the longer side, pixels.

    Returns:
        Bytes. [H', W', 3]
    """
    height, width = pixels.shape[:2]
    factor = longest / max(height, width)
    if factor >= 1:
        return pixels
    from PIL import Image

    size = max(1, round(width * factor)), max(1, round(height * factor))
    return np.asarray(Image.fromarray(pixels).resize(size, Image.Resampling.BOX))


def data_uri(pixels: NDArray[np.uint8], longest: int = 4096) -> str:
    """A picture as a data: URI (PNG)."""
    from PIL import Image

    stream = io.BytesIO()
    Image.fromarray(np.ascontiguousarray(fit(pixels, longest))).save(stream, "PNG", optimize=True)
    return "data:image/png;base64," + base64.b64encode(stream.getvalue()).decode()


def crop_box(masks: list[NDArray[np.bool_]], margin: float = 0.06) -> tuple[slice, slice]:
    """Find the rows and columns around everything that is set in any mask.

    Args:
        masks: of one size. [H, W] each
        margin: share of the longer side that is added all round.

    Returns:
        Row and column slices; the whole where nothing is set.
    """
    union = np.logical_or.reduce(masks)
    if not union.any():
        return slice(None), slice(None)
    rows, columns = np.flatnonzero(union.any(1)), np.flatnonzero(union.any(0))
    pad = int(margin * max(np.ptp(rows), np.ptp(columns))) + 1
    top, left = max(rows[0] - pad, 0), max(columns[0] - pad, 0)
    return slice(top, rows[-1] + pad + 1), slice(left, columns[-1] + pad + 1)


def picture(pixels: NDArray[np.uint8], title: str, text: str, longest: int, place: str = "") -> dict[str, str]:
    """Make one figure of a page.

    Args:
        pixels: RGB bytes. [H, W, 3]
        title, text: beneath it.
        longest: the longer side that is shown, pixels.
        place: "first" starts a row.

    Returns:
        What the templates want of a figure: `src` (a data URI), `title`, `text`, `place`.
    """
    return {"src": data_uri(pixels, longest), "title": title, "text": text, "place": place}


def polarisation(stokes: NDArray) -> tuple[NDArray, NDArray]:
    """Compute DoLP and AoLP of the colour mean.

    Args:
        stokes: s0, s1, s2 by R, G, B. [H, W, 3, 3]

    Returns:
        DoLP, 0 where s0 <= `DARK` [H, W], and AoLP in radians [H, W].
    """
    mean = stokes.mean(-1)
    return np.where(mean[..., 0] > DARK, degree(mean), 0), angle(mean)


def evenly_chosen(names: Sequence[str], most: int) -> list[str]:
    """Choose some of many names, evenly spread, the first and last among them.

    Args:
        names: in order.
        most: how many at most.

    Returns:
        The chosen, in order.
    """
    return [names[i] for i in sorted({round(k) for k in np.linspace(0, len(names) - 1, min(len(names), most))})]


def exposure_of(image: NDArray) -> float:
    """Find a factor that puts the brightest percents of the object at display white.

    Args:
        image: linear, 0 outside the object. [H, W, 3]

    Returns:
        The factor; 1 for images that are bright enough.
    """
    bright = image[image.max(-1) > 1e-4]
    return float(1 / max(np.percentile(bright, 98), 1e-6)) if len(bright) and np.percentile(bright, 98) < 0.6 else 1.0
