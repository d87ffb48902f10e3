"""Many pixels at once, over threads.

Threads of our own, not numba's: the kernel releases the interpreter's lock, cameras may be fitted side by side, and a parallel
region would be compiled a second time.
"""

from __future__ import annotations

import os
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pipeline.kernels import native
from pipeline.rig.light_table import LightTable
from stages.olat.pixel_fit.fit_options import WORKSPACE_PER_LIGHT, FitOptions
from stages.olat.pixel_fit.result_layout import WIDTH

SHARE = 64  # pixels that a thread takes at a time: a few milliseconds, so that threads end together
SOURCE = Path(__file__).with_name("many_pixels_kernel.py")
ARGUMENTS = ("int64",) * 5 + ("pointer",) * 15


def half_table() -> NDArray[np.float32]:
    """float32 [65536]: the value of every half float by its bits."""
    return np.arange(65536, dtype=np.uint16).view(np.float16).astype(np.float32)


def ready(half: bool, precision: str) -> bool:
    """Whether the kernel for frames of half floats, or of floats, was compiled before."""
    return native.compiled(_name("uint16" if half else "float32", precision), SOURCE)


def load(half: bool, precision: str) -> None:
    """Load that kernel; compile it where it was not."""
    _kernel("uint16" if half else "float32", precision)


def _name(sample: str, precision: str) -> str:
    return f"fit-{sample}-{precision}"


def _kernel(sample: str, precision: str) -> native.Kernel:
    def build() -> tuple[str, bytes]:
        from stages.olat.pixel_fit.many_pixels_kernel import build as compile_kernel  # loads numba

        return compile_kernel(sample, precision)

    return native.kernel(_name(sample, precision), SOURCE, ARGUMENTS, build)


def fit(
    cross: NDArray, parallel: NDArray, view: NDArray, rig: LightTable, settings: FitOptions, precision: str = "float32",
    points: NDArray | None = None, threads: int | None = None, part: tuple[int, int] | None = None,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:  # fmt: skip
    """Fit the pixels of samples [N, P, 3] (half-float bits or floats) under a `LightTable` with solid angles.

    view [P, 3]: unit, to the camera; points [P, 3]: where each pixel's surface is, for near lights; part: fit only pixels
    [first, last). Returns rows float64 [P, WIDTH] and norms [P, 2] (specular gradient norm, passes). The result does not depend
    on the number of threads.
    """
    kind = np.dtype(precision)
    count, pixels = cross.shape[:2]
    stored = cross.dtype if cross.dtype == np.uint16 or cross.itemsize < kind.itemsize else kind
    out, norms = np.zeros((pixels, WIDTH)), np.zeros((pixels, 2))
    arrays = (
        np.ascontiguousarray(cross, stored), np.ascontiguousarray(parallel, stored), half_table(),
        np.ascontiguousarray(view, np.float64), np.ascontiguousarray(view if points is None else points, np.float64),
        np.ascontiguousarray(rig.directions.T, kind), np.ascontiguousarray(rig.positions, np.float64),
        np.ascontiguousarray(rig.solid_angle, kind), np.ascontiguousarray(rig.intensity, kind),
        np.ascontiguousarray(rig.gains.T, kind), np.array(settings, np.float64),
    )  # fmt: skip
    kernel = _kernel(stored.name, precision)
    first, last = part or (0, pixels)

    workers = threads or os.cpu_count() or 1
    workspaces = [(np.empty(WORKSPACE_PER_LIGHT * count, kind), np.empty(count, np.int64)) for _ in range(workers)]
    given = [array.ctypes.data for array in arrays]

    def share(start: int) -> None:
        workspace, front = own = workspaces.pop()
        addresses = (array.ctypes.data for array in (workspace, front, out, norms))
        kernel(start, min(start + SHARE, last), count, pixels, points is not None, *given, *addresses)
        workspaces.append(own)

    with ThreadPoolExecutor(workers) as pool:
        list(pool.map(share, range(first, last, SHARE)))
    return out[first:last], norms[first:last]
