"""What is told of an object that moved: between the passes, and during one, by its frames under all lights."""

from __future__ import annotations

import numpy as np

from pipeline.engine.stage import StageRun
from stages.olat.reading.misregistration import WARN_PX, Misregistration
from stages.olat.reading.movement import Movement, movement_between
from stages.olat.reading.rig_cameras import CameraJob
from stages.olat.reading.stream import Undone
from stages.olat.reading.tracking_frames import movement_during


def say_undone(stage: StageRun, job: CameraJob, undone: Undone) -> None:
    """Tell of a shift or a turn between the passes that was undone on reading.

    Args:
        stage: the run.
        job: the camera.
        undone: what was.
    """
    right, down, turn = undone
    if not (right or down or turn):
        return
    turned = ""
    if turn is not None:
        degrees = -float(np.degrees(turn.radians))
        turned = f", turned by {degrees:+.2f} degrees,"
        stage.note(f"{job.name}.aligned_deg", round(degrees, 3))
    stage.note(f"{job.name}.aligned_px", [round(right, 2), round(down, 2)])
    stage.warn(
        f"{job.name}: the parallel pass lay {right:+.3g} px right and {down:+.3g} px down of the crossed one{turned} and was "
        "read back into place; capture again with the object fixed for better maps"
    )


def tell_movement(stage: StageRun, job: CameraJob, passes: Misregistration | None) -> None:
    """Keep and tell how a camera's passes lie off each other, and how its object moved during the crossed one.

    Args:
        stage: the run.
        job: the camera.
        passes: their mean images, after what was undone; None: nothing was read.
    """
    right, down = passes.shift() if passes is not None else (0.0, 0.0)
    stage.note(f"{job.name}.drift_px", [round(right, 2), round(down, 2)])
    shifted = max(abs(right), abs(down)) > WARN_PX
    if shifted:
        stage.warn(
            f"{job.name}: the parallel pass lies {right:+.1f} px right and {down:+.1f} px down of the crossed one; "
            "specular maps will show edges there: align the frames before, or capture again with the object fixed"
        )
    between = None
    if passes is not None and job.passes == "both":
        between = movement_between(*passes.means, passes.means[0] > 0, passes.step)
    if between is not None:
        stage.note(f"{job.name}.drift", between.as_json())
        if between.turned and between.furthest_px > WARN_PX and not shifted:
            stage.warn(
                f"{job.name}: the parallel pass is turned by {between.turn_deg:+.2f} degrees against the crossed one "
                f"({between.furthest_px:.1f} px at the object's edge{_left(between)}); specular maps will show edges there: "
                "capture again with the object fixed"
            )
    stage_camera = stage.capture.light_stage.cameras.get(job.name) if stage.capture.light_stage is not None else None
    during = movement_during(stage_camera, job.mask) if stage_camera is not None and stage_camera.full_light else None
    if during is None:
        return
    stage.note(f"{job.name}.tracking", during.as_json())
    if during.furthest_px > WARN_PX:
        turn = f" and turned by {during.turn_deg:+.2f} degrees" if during.turned else ""
        stage.warn(
            f"{job.name}: between the frames under all lights before and after the pass the object moved "
            f"{during.right:+.1f} px right and {during.down:+.1f} px down{turn} ({during.furthest_px:.1f} px at most"
            f"{_left(during)}): the samples of a pixel are not of one place; capture again with the object fixed"
        )


def _left(movement: Movement) -> str:
    return "" if movement.residual_px is None else f"; {movement.residual_px:.1f} px are left of it"
