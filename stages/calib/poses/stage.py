"""Poses: given cameras written out, or found with COLMAP on polariser-independent images."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from pipeline.capture import Capture
from pipeline.engine.stage import Decision, Stage, StageRun
from pipeline.geometry.cameras import Camera
from stages import memory_estimate, time_estimate
from stages.calib.poses.parameters import PosesParameters


def needed(capture: Capture, parameters: PosesParameters) -> Decision:
    """Every multi-view capture has cameras written in one schema; only some need them found."""
    if capture.kind == "light_stage":
        return Decision(False, "the light stage's camera files hold its cameras")
    if capture.cameras is not None:
        source = "an existing COLMAP model" if capture.colmap is not None else "the capture"
        passes = {
            "colmap": Decision(False, f"cameras are given by {source}"),
            "triangulation": Decision(
                parameters.triangulate, "asked for" if parameters.triangulate else "not asked for (poses.triangulate)"
            ),
            "undistortion": _undistortion(capture.cameras.values()),
        }
        return Decision(True, f"cameras are given by {source}: they are written in one schema", passes)
    return Decision(True, f"no cameras: found from {len(capture.views)} views", {"colmap": Decision(True, "no cameras given")})


def _undistortion(cameras: Iterable[Camera]) -> Decision:
    """Whether pictures are bent straight: where a lens is no pinhole."""
    bent = sum(not camera.is_pinhole for camera in cameras)
    return Decision(bent > 0, f"{bent} views through a lens that bends lines" if bent else "no camera's lens bends lines")


def capture_files(capture: Capture) -> Iterable[Path]:
    """The files that hold cameras (neither views, masks nor environments), and masks where cameras depend on them."""
    from pipeline.geometry.straight_camera import is_wide

    views = {p for view in capture.views for p in view.paths}
    masks = set(capture.masks.values()) if isinstance(capture.masks, dict) else set()
    others = views | masks | set(capture.environments)
    masked = capture.cameras is None or any(is_wide(camera) for camera in capture.cameras.values())
    return [p for p in capture.files if p not in others] + (sorted(masks) if masked else [])


def run(stage: StageRun) -> None:
    """Write cameras.json, sparse/ and, where points are known, points.ply."""
    if stage.capture.cameras is not None:
        from stages.calib.poses.given import write_given

        write_given(stage)
    else:
        from stages.calib.poses.find import find_cameras

        find_cameras(stage)


STAGE = Stage(
    name="poses",
    version=4,
    parameters=PosesParameters,
    needs=("decode",),
    needed=needed,
    run=run,
    capture_files=capture_files,
    config=("poses", "unit_m", "up"),
    memory=memory_estimate.poses,
    costs=time_estimate.poses,
    parallel=0.9,
)
