"""Which stages' kernels this machine has yet to compile, and how long that takes; loads no numba."""

from __future__ import annotations

from pipeline.kernels.kept import is_kept

FIRST_S: dict[str, tuple[str, float]] = {
    "decode": ("stages/calib/decode/frame_scan_kernel.py", 1.8),
    "masks": ("stages/masks/hull_check.py", 2.5),
    "train": ("stages/train/rasterize/kernel_backward.py", 60.0),
    "mesh": ("pipeline/geometry/fusion_kernel.py", 10.0),
    "relight": ("pipeline/shading/light_tree_kernels.py", 20.0),
}
"""For each stage a file of its kernels that no run of it does without, and the seconds that compiling all of them takes."""


def compiling_s(stage: str) -> float:
    """Estimate what a stage will spend compiling its kernels first.

    Args:
        stage: its name.

    Returns:
        Seconds of one core of the reference machine; 0 where code of its present sources is kept.
    """
    file, seconds = FIRST_S.get(stage, ("", 0.0))
    return 0.0 if not file or is_kept(file) else seconds
