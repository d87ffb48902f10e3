"""The frames' evidence against the light table and each other alone, without a fit: seconds, where fits take minutes."""

from __future__ import annotations

from itertools import islice

from pipeline.engine.stage import StageRun
from stages.olat.evidence.before_fits import check_capture, check_rig
from stages.olat.parameters import every
from stages.olat.reading.rig_cameras import decoded, light_rig
from stages.olat.reading.stream import reading


def check_early(stage: StageRun) -> None:
    """Warn, or raise, as a run of the olat stage would before its fits. Writes nothing.

    Args:
        stage: the run.

    Raises:
        UserError: the frames contradict the light table or each other.
    """
    stage = stage.of_light_stage()
    rig = light_rig(decoded(stage), every(stage.parameters.lights))
    with reading(stage) as lanes:
        check_rig(stage, rig, stage.capture.config.olat.near_light)
        check_capture(stage, list(islice(lanes.pieces[0], 1)), rig)
