"""Relight: the model under other environment maps; a light stage by the sum of its frames and by its fitted maps."""

from __future__ import annotations

from pipeline.capture import Capture
from pipeline.capture.view_rules import too_few_views
from pipeline.engine.stage import Decision, Stage, StageRun

from .parameters import RelightParameters


def needed(capture: Capture, parameters: RelightParameters) -> Decision:
    """Where there are maps, and something that can be lit."""
    if capture.kind != "light_stage" and (few := too_few_views(capture)):
        return Decision(False, few)
    count = len(capture.environments)
    if not count:
        return Decision(False, "no environment maps: none in envmaps/, none in ENVS=")
    maps = f"{count} environment map" + ("s" if count > 1 else "")
    if capture.kind == "light_stage":
        return Decision(True, f"{maps}: summed from the frames and rendered from the fitted maps")
    return Decision(True, f"{maps} to light the model with")


def run(run: StageRun) -> None:
    """Write ENV/VIEW.exr (or ENV/camNN.exr and ENV/camNN_olat.exr) for every map."""
    if run.capture.kind == "light_stage":
        from .camera_images import relight_stage

        relight_stage(run)
    else:
        from .view_images import relight_views

        relight_views(run)


STAGE = Stage(
    name="relight",
    version=5,
    parameters=RelightParameters,
    needs=("decode", "poses", "masks", "olat", "train", "mesh"),
    needed=needed,
    run=run,
    config=("up", "olat"),
    environments=True,
)
