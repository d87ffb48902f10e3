"""Which stages' kernels this machine has yet to compile, and how long that takes; loads no numba."""

from __future__ import annotations

import os
from functools import cache

from pipeline.kernels import freshness, storage

FIRST_S: dict[str, tuple[str, float]] = {
    "decode": ("stages/calib/decode/frame_scan_kernel.py", 1.8),
    "masks": ("stages/masks/hull_check.py", 2.5),
    "train": ("stages/train/rasterize/kernel_backward.py", 60.0),
    "mesh": ("stages/mesh/fusion_kernel.py", 10.0),
    "relight": ("pipeline/shading/light_tree_kernels.py", 20.0),
}
"""For each stage a file of its kernels that no run of it does without, and the seconds that compiling all of them takes."""


def compiling_s(stage: str) -> float:
    """Seconds of the reference machine that a stage will spend compiling first; 0 where code of its present sources is kept."""
    file, seconds = FIRST_S.get(stage, ("", 0.0))
    return 0.0 if not file or _kept(file) else seconds


@cache
def _kept(file: str) -> bool:
    folder, path = storage.place(), storage.ROOT / file
    if folder is None or not path.is_file():
        return False
    label = storage.label(freshness.dotted(path), freshness.digest(path))
    return any(f"-{label}." in name for name in os.listdir(folder))
