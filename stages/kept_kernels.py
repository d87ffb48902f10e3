"""Which stages' kernels this machine has yet to compile, and how long that takes; loads no numba."""

from __future__ import annotations

from pipeline.kernels.kept import is_kept

COMPILE_S: dict[str, dict[str, float]] = {
    "decode": {"pipeline/formats/exr_kernels.py": 0.7, "stages/calib/decode/frame_scan_kernel.py": 0.4},
    "masks": {"stages/masks/hull_check.py": 1.3},
    "train": {
        "pipeline/shading/shade_kernels.py": 9.5, "pipeline/shading/lobe.py": 9.0, "pipeline/shading/symmetry.py": 4.0,
        "pipeline/shading/prefilter_kernels.py": 3.6, "pipeline/shading/cube_kernels.py": 1.4,
        "pipeline/shading/mirrored_kernel.py": 1.1, "stages/train/rasterize/kernel_backward.py": 6.2,
        "stages/train/rasterize/kernel_project.py": 4.7, "stages/train/rasterize/kernel_forward.py": 2.3,
        "stages/train/rasterize/kernel_block.py": 1.9, "stages/train/rasterize/kernel_bin.py": 1.6,
        "stages/train/splats/splat_kernels.py": 3.6, "stages/train/splats/surface_kernels.py": 2.1,
        "stages/train/pixel_kernels.py": 1.9,
    },
    "mesh": {
        "pipeline/geometry/fusion_kernel.py": 2.9, "pipeline/asset/blend_kernel.py": 20.0,
        "pipeline/asset/atlas_kernel.py": 3.0,
    },
    "relight": {"pipeline/shading/light_tree_kernels.py": 7.0, "pipeline/shading/sharp_kernels.py": 4.0},
}  # fmt: skip
"""For each stage the files of the kernels that no usual run of it does without and no stage before it compiles, with the
seconds of one core of the reference machine that compiling them takes: what a run without any kept code takes above one with
it, shared among the files as the compiler's own time is."""


def compiling_s(stage: str) -> float:
    """Estimate what a stage will spend compiling its kernels first.

    Args:
        stage: its name.

    Returns:
        Seconds of one core of the reference machine; 0 where code of their present sources is kept.
    """
    return sum(seconds for file, seconds in COMPILE_S.get(stage, {}).items() if not is_kept(file))
