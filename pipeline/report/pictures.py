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
    """Linear RGB [H, W, 3] as sRGB bytes, clipped."""
    return to_bytes(srgb_encode(np.nan_to_num(linear) * exposure))


def normals(normal: NDArray) -> NDArray[np.uint8]:
    """Unit normals [H, W, 3] as (n + 1) / 2, black where there is none."""
    there = np.linalg.norm(normal, axis=-1, keepdims=True) > 0.5
    return to_bytes(np.where(there, normal * 0.5 + 0.5, 0))


def scale(values: NDArray, low: float, high: float, anchors: tuple = INFERNO, mask: NDArray | None = None) -> NDArray[np.uint8]:
    """Numbers [H, W] on a colour scale from `low` to `high`; black outside the mask."""
    share = np.clip((np.nan_to_num(values) - low) / (high - low), 0, 1)
    at = np.linspace(0, 1, len(anchors))
    colour = np.stack([np.interp(share, at, [a[k] for a in anchors]) for k in range(3)], -1)
    return (colour if mask is None else colour * mask[..., None]).round().astype(np.uint8)


def angles(angle: NDArray, strength: NDArray) -> NDArray[np.uint8]:
    """Angles modulo pi [H, W] (radians) as hues, faded to black by `strength` in 0..1."""
    phase = 2 * angle[..., None] + np.array([0.0, 2 * np.pi / 3, 4 * np.pi / 3])
    return to_bytes((0.55 + 0.45 * np.cos(phase)) * np.clip(strength, 0, 1)[..., None])


def to_bytes(display: NDArray) -> NDArray[np.uint8]:
    """Display values in 0..1 as bytes."""
    return (np.clip(display, 0, 1) * 255 + 0.5).astype(np.uint8)


def fit(pixels: NDArray[np.uint8], longest: int) -> NDArray[np.uint8]:
    """Shrunk so that the longer side is at most `longest` pixels; never enlarged."""
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
    """Rows and columns around everything that is set in any mask of one size, with a margin."""
    union = np.logical_or.reduce(masks)
    if not union.any():
        return slice(None), slice(None)
    rows, columns = np.flatnonzero(union.any(1)), np.flatnonzero(union.any(0))
    pad = int(margin * max(np.ptp(rows), np.ptp(columns))) + 1
    top, left = max(rows[0] - pad, 0), max(columns[0] - pad, 0)
    return slice(top, rows[-1] + pad + 1), slice(left, columns[-1] + pad + 1)


def picture(pixels: NDArray[np.uint8], title: str, text: str, longest: int, place: str = "") -> dict[str, str]:
    """One figure of a page; place "first" starts a row."""
    return {"src": data_uri(pixels, longest), "title": title, "text": text, "place": place}


def polarisation(stokes: NDArray) -> tuple[NDArray, NDArray]:
    """DoLP and AoLP (radians) of the colour mean; 0 where it is dark."""
    mean = stokes.mean(-1)
    return np.where(mean[..., 0] > DARK, degree(mean), 0), angle(mean)


def evenly_chosen(names: Sequence[str], most: int) -> list[str]:
    """At most `most` of the names, evenly spread, the first and last among them."""
    return [names[i] for i in sorted({round(k) for k in np.linspace(0, len(names) - 1, min(len(names), most))})]


def exposure_of(image: NDArray) -> float:
    """A factor that puts the brightest percent of the object at display white; 1 for images that are bright enough."""
    bright = image[image.max(-1) > 1e-4]
    return float(1 / max(np.percentile(bright, 98), 1e-6)) if len(bright) and np.percentile(bright, 98) < 0.6 else 1.0
