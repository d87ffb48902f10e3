"""What some pixels of a light-stage camera measured under every light, beside what was fitted to them: `samples.npz`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pipeline.formats.arrays import array_names, read_array

NUMBERS = (
    "diffuse_albedo", "specular_albedo", "diffuse_normal", "specular_normal", "tangent", "sigma", "residual",
)  # fmt: skip
"""Of the fit: as the maps of that name, but that the widths are the pixel's own, the spread of its normals in them."""


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
        UserError: the file is damaged, or lacks one of the arrays.
    """
    pixels, lights, cross = (read_array(path, name) for name in ("pixels", "lights", "cross"))
    parallel = read_array(path, "parallel") if "parallel" in array_names(path) else None
    return KeptSamples(pixels, lights, cross, parallel, {name: read_array(path, name) for name in NUMBERS})
