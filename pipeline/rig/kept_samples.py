"""What some pixels of a light-stage camera measured under every light, beside what was fitted to them: `samples.npz`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import UserError
from pipeline.formats.arrays import array_names, read_array

NUMBERS = (
    "diffuse_albedo", "specular_albedo", "diffuse_normal", "specular_normal", "tangent", "sigma", "residual",
)  # fmt: skip
"""Of the fit: as the maps of that name, but that the widths are the pixel's own, the spread of its normals in them."""

LARGEST = 1 << 28
"""Bytes of one array: a megapixel's samples under forty lights, a thousand times what is kept."""


@dataclass(frozen=True)
class KeptSamples:
    """K pixels under L lights.

    Fields:
        pixels: flat indices into the frame. [K]
        lights: which of the light table's they are. [L]
        cross: samples as they were read. [K, L, 3]
        parallel: those of the other pass; None where the camera has one. [K, L, 3]
        numbers: of the fit, by the names of NUMBERS. [K, C]
    """

    pixels: NDArray[np.int64]
    lights: NDArray[np.int64]
    cross: NDArray[np.float16]
    parallel: NDArray[np.float16] | None
    numbers: dict[str, NDArray[np.float32]]


def write_kept_samples(path: Path, kept: KeptSamples) -> None:
    """Write samples of a few pixels.

    Args:
        path: the .npz.
        kept: what is written.
    """
    passes = {"cross": kept.cross} | ({} if kept.parallel is None else {"parallel": kept.parallel})
    arrays: dict[str, NDArray] = {"pixels": kept.pixels, "lights": kept.lights, **passes, **kept.numbers}
    with path.open("wb") as file:
        np.savez_compressed(file, **arrays)  # type: ignore[arg-type]


def read_kept_samples(path: Path) -> KeptSamples:
    """Read what `write_kept_samples` wrote.

    Args:
        path: the .npz.

    Returns:
        The samples.

    Raises:
        UserError: the file is damaged, lacks one of the arrays, or they do not fit each other.
    """
    pixels, lights, cross = (read_array(path, name, LARGEST) for name in ("pixels", "lights", "cross"))
    parallel = read_array(path, "parallel", LARGEST) if "parallel" in array_names(path) else None
    numbers = {name: read_array(path, name, LARGEST) for name in NUMBERS}
    samples = (len(pixels), len(lights), 3) if pixels.ndim == lights.ndim == 1 else ()
    fitting = all(a.shape == samples for a in (cross, parallel) if a is not None)
    fitting &= all(a.ndim == 2 and len(a) == len(pixels) for a in numbers.values())
    if not (fitting and all(a.dtype.kind in "iu" and (a.size == 0 or a.min() >= 0) for a in (pixels, lights))):
        raise UserError(path, "its arrays do not fit each other", "run the olat stage again")
    return KeptSamples(pixels, lights, cross, parallel, numbers)
