"""Masks: given ones and alpha copied, else the object is segmented and checked against the visual hull."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

from pipeline.capture import Capture
from pipeline.engine.stage import Decision, Stage, StageRun
from pipeline.formats.dataset_files import OLAT
from stages import memory_estimate, time_estimate
from stages.masks.parameters import MasksParameters, choose_method


def needed(capture: Capture, parameters: MasksParameters) -> Decision:
    """Always; segmentation only where nothing is given."""
    method, reason = choose_method(capture, parameters)
    segmented = method not in ("given", "alpha", "none")
    return Decision(True, reason, {"segmentation": Decision(segmented, reason)})


def capture_files(capture: Capture) -> Iterable[Path]:
    """Given masks and clean plates; a light stage without mattes is segmented from its frames, which decode digests."""
    masks = sorted(capture.masks.values()) if isinstance(capture.masks, dict) else []
    beside = capture_files(capture.olat) if capture.olat is not None else ()
    return [*masks, *sorted(set(capture.clean_plates.values())), *beside]


def memory(capture: Capture, parameters: MasksParameters, jobs: int) -> float:
    """MiB at its peak."""
    return memory_estimate.masks(capture, parameters, jobs, needed(capture, parameters).passes["segmentation"].run)


def run(stage: StageRun) -> None:
    """Write VIEW.png for every view (light stage: camNN.png) and masks.json; in olat/ those of a light stage beside views."""
    from stages.masks.run import make_masks

    make_masks(stage)
    if stage.capture.olat is not None:
        beside = replace(stage.of_light_stage(), output=stage.output / OLAT, facts={})
        beside.output.mkdir()
        make_masks(beside)
        stage.note(OLAT, beside.facts)


STAGE = Stage(
    name="masks",
    version=6,
    parameters=MasksParameters,
    needs=("decode", "poses"),
    needed=needed,
    run=run,
    capture_files=capture_files,
    config=("clean_plate",),
    memory=memory,
    costs=time_estimate.masks,
    parallel=0.6,
)
