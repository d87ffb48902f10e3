"""Cameras that the capture gives, in the dataset's two schemas."""

from __future__ import annotations

from pipeline.engine.stage import StageRun
from pipeline.formats.colmap import ColmapModel, read_model
from stages.calib.poses.straighten import write_cameras
from stages.calib.poses.write import write_points, write_sparse


def write_given(stage: StageRun) -> None:
    """Write cameras.json and sparse/ from given cameras; points of an existing model or, if asked, triangulated."""
    capture = stage.capture
    cameras = capture.cameras or {}
    write_cameras(stage, cameras)
    model: ColmapModel | None = read_model(capture.colmap) if capture.colmap is not None else None
    write_sparse(stage.output / "sparse", cameras)
    if stage.parameters.triangulate:
        from stages.calib.poses.find import triangulate

        triangulate(stage)
    elif model is not None and len(model.points):
        write_points(stage.output / "points.ply", model.points, model.colours)
