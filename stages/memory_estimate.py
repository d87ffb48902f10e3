"""What each stage has in memory at its peak (MiB), before it runs: its libraries, and what grows with the pictures.

Constants were measured with the pinned libraries on two cores: captures of 64 to 512 px, 10 to 40 views. One stage varies by a
fifth from run to run, more where it compiles kernels first (COMPILING).
"""

from __future__ import annotations

from typing import Any

from pipeline.capture import Capture
from pipeline.capture.view_rules import too_few_views
from stages.object_share import object_share
from stages.triangle_estimate import likely_triangles

MEBI = 2**20
PROGRAM = 80.0  # Python, numpy and this program
LOOKING = 135.0  # and OpenImageIO
READING = 195.0  # and numba
SURFACE = 420.0  # rays and the fields of a surface of 320 voxels
COMPILING = 350.0  # LLVM, while the fits of a light stage are compiled
SAMPLE_BYTES = {".exr": 2}  # half floats as they are; others are read as floats


def decode(capture: Capture, parameters: Any, jobs: int) -> float:
    """Estimate decode: a view at a time; a light stage's frames are read where they are no EXR.

    Args:
        capture: as recognised.
        parameters: of the stage.
        jobs: pieces side by side.

    Returns:
        MiB at the peak.
    """
    if capture.light_stage is not None:
        plain = all(c.cross and c.cross[0].suffix.lower() == ".exr" for c in capture.light_stage.cameras.values())
        from stages.calib.decode.frame_samples import EVERY, LARGE

        looked_at = _largest(capture) / (EVERY if _largest(capture) > LARGE else 1)
        return (LOOKING if plain else READING + 5) + 28 * looked_at * max(1, jobs) / MEBI
    mosaic = "mosaic" in capture.layout
    return READING + 30 * mosaic + 160 * _largest(capture) * max(1, jobs) / MEBI


def poses(capture: Capture, parameters: Any, jobs: int) -> float:
    """Estimate poses: given cameras are a table; found ones are COLMAP's pictures and features at `max_size`, on every core.

    Args:
        capture: as recognised.
        parameters: of the stage.
        jobs: pieces side by side.

    Returns:
        MiB at the peak.
    """
    if capture.cameras is not None and not parameters.triangulate:
        return PROGRAM
    return 300.0 + 60 * min(_largest(capture), parameters.max_size**2) / MEBI


def masks(capture: Capture, parameters: Any, jobs: int, segmented: bool) -> float:
    """Estimate masks: of all views, as bytes and as distances; colour models of the pictures where they are segmented.

    Args:
        capture: as recognised.
        parameters: of the stage.
        jobs: pieces side by side.
        segmented: masks are made, not given.

    Returns:
        MiB at the peak.
    """
    if capture.light_stage is not None and not segmented:
        return PROGRAM + 5
    return 230.0 + 13 * sum(capture.pixels) / MEBI + (130.0 if segmented else 0.0)


def olat(capture: Capture, parameters: Any, jobs: int, compiled: bool, again: bool) -> float:
    """Estimate olat: two bands of samples for each camera that is fitted beside another; the program that fits.

    Args:
        capture: a light stage.
        parameters: of the stage.
        jobs: pieces side by side.
        compiled: its kernels are; else LLVM, which compiles them, counts too.
        again: it fits a second time, with the surface.

    Returns:
        MiB at the peak.
    """
    assert capture.light_stage is not None
    cameras = list(capture.light_stage.cameras.values())
    samples = max(
        c.camera.width * c.camera.height * 6 * len(c.cross) * SAMPLE_BYTES.get(c.cross[0].suffix.lower(), 4) / MEBI
        for c in cameras if c.cross
    )  # fmt: skip
    lanes = max(1, min(jobs, len(cameras)))
    masks = (10 * _largest(capture) + (1 + 8 * object_share(capture)) * sum(capture.pixels)) / MEBI
    own = 130.0 + lanes * min(2 * parameters.band_mb, samples) + masks
    return own + (0.0 if compiled else COMPILING) + (SURFACE if again else 0.0)


def train(capture: Capture, parameters: Any, jobs: int) -> float:
    """Estimate train: torch; views with Stokes frame, mask and rays; splats with their moments and the buffers of a step.

    Args:
        capture: as recognised.
        parameters: of the stage.
        jobs: pieces side by side.

    Returns:
        MiB at the peak.
    """
    seen = sum(capture.pixels) / max(1, len(capture.pixels)) * object_share(capture)  # pixels of the object in a view
    return 650.0 + 100 * sum(capture.pixels) / MEBI + 3e-3 * parameters.likely_splats(seen)


def mesh(capture: Capture, parameters: Any, jobs: int) -> float:
    """Estimate mesh: open3d; depths of all views, and the voxels near the surface; of a light stage one camera's maps, and what
    all of them say of the surface's vertices.

    Args:
        capture: as recognised.
        parameters: of the stage.
        jobs: pieces side by side.

    Returns:
        MiB at the peak.
    """
    if capture.light_stage is not None:
        triangles = likely_triangles(capture, parameters.voxel_px, parameters.max_voxels)
        return 510.0 + 6.5e-4 * triangles + 200 * _largest(capture) / MEBI
    return 390.0 + 55 * sum(capture.pixels) / MEBI + (150.0 if parameters.poisson else 0.0)


def relight(capture: Capture, parameters: Any, jobs: int) -> float:
    """Estimate relight: of a light stage, its maps; of a model, the mesh's tree, the maps filtered at every roughness, a view.

    Args:
        capture: as recognised.
        parameters: of the stage.
        jobs: pieces side by side.

    Returns:
        MiB at the peak.
    """
    largest = _largest(capture)
    if capture.light_stage is not None:
        return 280.0 + 250 * largest / MEBI
    return 500.0 + 3.5 * parameters.cube + 250 * sum(capture.pixels) / MEBI / max(1, len(capture.views)) ** 0.5


def metrics(capture: Capture, parameters: Any, jobs: int) -> float:
    """Estimate metrics: torch, for what the report lets one turn, and the pictures; open3d beside it where there is a mesh.

    Args:
        capture: as recognised.
        parameters: of the stage.
        jobs: pieces side by side.

    Returns:
        MiB at the peak.
    """
    solid = capture.light_stage is None and too_few_views(capture) is None
    return (550.0 if solid else 345.0) + 60 * _largest(capture) / MEBI


def _largest(capture: Capture) -> int:
    return max(capture.pixels, default=0)
