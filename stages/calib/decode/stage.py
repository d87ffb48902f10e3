"""Decode: every view as linear Stokes or colour EXR; light-stage frames stay where they are and are indexed."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from pipeline.capture import Capture
from pipeline.engine.stage import Decision, Stage, StageRun
from stages import memory_estimate, time_estimate
from stages.calib.decode.parameters import DecodeParameters


def needed(capture: Capture, parameters: DecodeParameters) -> Decision:
    """Always: every later stage reads linear frames, or the index of a light stage."""
    if capture.kind == "light_stage":
        return Decision(True, "light-stage frames are indexed where they lie")
    what = {
        "stokes": "full Stokes: no polariser angles to find",
        "polarisers": f"colour behind {len(capture.camera_names)} polarisers: (s0, s1, s2) is left to training",
        "none": "plain colour: no polarisation",
    }[capture.polarisation]
    return Decision(True, what)


def capture_files(capture: Capture) -> Iterable[Path]:
    """Everything that carries pixels or says what they mean; of a light stage also tables, cameras and mattes."""
    if capture.kind == "light_stage":
        return [p for p in capture.files if p not in capture.environments]
    paths = [p for view in capture.views for p in view.paths]
    radiometry = capture.config.radiometry
    beside = capture_files(capture.olat) if capture.olat is not None else ()
    return [*paths, *(capture.root / p for p in (radiometry.dark_frame, radiometry.flat_field) if p), *beside]


def run(stage: StageRun) -> None:
    """Fill frames/ and frames.json, or olat.json; both of a capture of both kinds."""
    if stage.capture.kind == "multiview":
        from stages.calib.decode.write_frames import decode_views

        decode_views(stage)
    if stage.capture.one_light_at_a_time.light_stage is not None:
        from stages.calib.decode.olat_index import index_light_stage

        index_light_stage(stage.of_light_stage())


STAGE = Stage(
    name="decode",
    version=6,
    parameters=DecodeParameters,
    needs=(),
    needed=needed,
    run=run,
    capture_files=capture_files,
    config=("stokes", "radiometry", "mosaic", "stack", "raw", "polarisers", "olat"),
    memory=memory_estimate.decode,
    costs=time_estimate.decode,
    parallel=0.3,
)
