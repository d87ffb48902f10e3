"""Cameras that the capture gives, in the dataset's two schemas."""

from __future__ import annotations

from pipeline.engine.stage import StageRun
from pipeline.formats.colmap import ColmapModel, read_model
from pipeline.formats.dataset_files import POINTS
from pipeline.geometry.world_offset import less
from stages.calib.poses.straighten import write_cameras
from stages.calib.poses.write import FRAME_SUFFIX, write_points, write_sparse


def write_given(stage: StageRun) -> None:
    """Write cameras.json and sparse/ from given cameras; points of an existing model or, if asked, triangulated."""
    capture = stage.capture
    cameras = capture.cameras or {}
    offset = write_cameras(stage, cameras)
    cameras = {view: less(camera, offset) for view, camera in cameras.items()}
    told = capture.config.poses
    idle = [key for key in ("focal_px", "scale_pair", "marker_length") if getattr(told, key) is not None]
    if idle:
        stage.warn(
            f"{capture.config.path}: poses.{idle[0]} has no effect, as the capture gives its cameras: remove it, "
            "or the cameras to have them found"
        )
    model: ColmapModel | None = read_model(capture.colmap) if capture.colmap is not None else None
    write_sparse(stage.output / "sparse", cameras, suffix=FRAME_SUFFIX, offset=offset)
    if stage.parameters.triangulate:
        from stages.calib.poses.find import triangulate

        triangulate(stage, cameras, offset)
    elif model is not None and len(model.points):
        write_points(stage.output / POINTS, model.points - offset, model.colours, offset)
