"""What the viewer shows of the fit of single pixels: samples under every light, and the fitted lobe's curve."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.capture.model import Passes
from pipeline.geometry.cameras import Camera
from pipeline.rig.kept_samples import KeptSamples
from pipeline.rig.lobe_curves import lobe_curves

from .packing import octahedral, packed

BYTES = 3_000_000
"""Of all cameras' samples in the page, about."""
PACKED = 1.2  # bytes of the page a byte of samples takes: deflate saves a tenth, base64 adds a third
ANGLES = np.linspace(0.0, 1.0, 32) ** 2 * 88.0
"""Of the half vector to the normal (degrees) at which a lobe's curve is evaluated: denser at the peak."""
NOTHING = -32768  # of both numbers where there is no direction
HALF_MAX = 65504.0


def most_pixels(lights: int, cameras: int) -> int:
    """Count the pixels of one camera that fit into the page.

    Args:
        lights: of the rig.
        cameras: that are shown.
    """
    return int(BYTES / (PACKED * (4 * lights + 4 * len(ANGLES) + 24)) / max(1, cameras))


@dataclass(frozen=True)
class Shown:
    """How a light stage's samples become light: `irradiance` of each light by channel [L, 3], `directions` to them [L, 3], f of
    I_s = f (I_p - I_x), and the number of the fitted lobe."""

    irradiance: NDArray[np.float64]
    directions: NDArray[np.float64]
    specular_factor: float
    lobe: int


def fit_entry(
    kept: KeptSamples, camera: Camera, shown: Shown, passes: Passes, corner: tuple[int, int], step: int, most: int
) -> dict[str, Any]:
    """One camera's kept pixels, at most `most` of them, evenly.

    Args:
        kept: the samples, and the fit.
        camera: whose they are.
        shown: what they are samples of.
        passes: that the camera has.
        corner, step: of the picture in the page: its first row and column, and every how many-th pixel it holds.
        most: pixels.

    Returns:
        `at` [K, 2] (column, row in the picture), directions, `fit` [K, 4] (widths, specular and diffuse albedo), `body` [K, L]
        (pi I_d / E), and where there is a lobe `mirrored` [K, L] (I_s / E) and `curves` [K, 2, ANGLES] (along the larger and
        the smaller width).
    """
    chosen = np.unique(np.linspace(0, len(kept.pixels) - 1, min(most, len(kept.pixels))).round().astype(int))
    n = {name: values[chosen].astype(np.float64) for name, values in kept.numbers.items()}
    row, column = np.divmod(kept.pixels[chosen], camera.width)
    view = -camera.rays_through(kept.pixels[chosen])
    grey = n["diffuse_albedo"].mean(-1, keepdims=True)
    body, mirrored = measured(kept, chosen, shown, passes, n)
    entry = {
        "at": packed((np.stack([column - corner[1], row - corner[0]], -1) / step).astype(np.float32)),
        **{name: packed(directions_or_nothing(n[name])) for name in ("diffuse_normal", "specular_normal", "tangent")},
        "view": packed(octahedral(view)), "body": packed(halves(body)),
        "fit": packed(halves(np.concatenate([n["sigma"], n["specular_albedo"], grey], -1))),
    }  # fmt: skip
    if mirrored is not None:
        curves = lobe_curves(
            shown.lobe, view, n["specular_normal"], n["tangent"], n["sigma"], n["specular_albedo"][:, 0], np.radians(ANGLES)
        )
        entry |= {"mirrored": packed(halves(mirrored)), "curves": packed(halves(curves))}
    return entry


def measured(
    kept: KeptSamples, chosen: NDArray, shown: Shown, passes: Passes, numbers: dict[str, NDArray]
) -> tuple[NDArray, NDArray | None]:
    """Body light over that of a white surface that faces the light [K, L], and mirrored light over irradiance (1/sr) [K, L]."""
    cross = (kept.cross[chosen] / shown.irradiance).mean(-1)
    if kept.parallel is not None:
        return 2 * np.pi * cross, shown.specular_factor * ((kept.parallel[chosen] / shown.irradiance).mean(-1) - cross)
    whole = np.pi * cross * (1 if passes == "none" else 2)
    if passes == "cross":
        return whole, None
    cosine = np.maximum(numbers["diffuse_normal"] @ shown.directions.T, 0)
    return whole, (whole - numbers["diffuse_albedo"].mean(-1, keepdims=True) * cosine) / np.pi


def directions_or_nothing(vectors: NDArray) -> NDArray[np.int16]:
    """Vectors [..., 3] as `octahedral` stores them, NOTHING where they have no length."""
    some = np.linalg.norm(vectors, axis=-1, keepdims=True) > 0.5
    return np.where(some, octahedral(vectors), NOTHING).astype(np.int16)


def halves(values: NDArray) -> NDArray[np.uint16]:
    """Numbers as the bits of half floats; 0 for what is none."""
    return np.clip(np.nan_to_num(values), -HALF_MAX, HALF_MAX).astype("<f2").view(np.uint16)
