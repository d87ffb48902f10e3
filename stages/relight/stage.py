"""Relight: the model under other environment maps; a light stage by the sum of its frames and by its fitted maps."""

from __future__ import annotations

from pipeline.capture import Capture
from pipeline.capture.view_rules import too_few_views
from pipeline.engine.stage import Decision, Stage, StageRun
from pipeline.environments import NO_MAPS, shipped_map
from stages import memory_estimate, time_estimate

from .given_files import given_files
from .parameters import RelightParameters


def needed(capture: Capture, parameters: RelightParameters) -> Decision:
    """Where there are maps, and something that can be lit."""
    if capture.kind != "light_stage" and (few := too_few_views(capture)):
        return Decision(False, few)
    if not capture.environments and not parameters.lights:
        return Decision(False, f"no environment maps: none in envmaps/, and ENVS={NO_MAPS}")
    maps = _counted(capture, parameters)
    if capture.kind == "light_stage":
        return Decision(True, f"{maps}: summed from the frames and rendered from the fitted maps")
    turning = "asked for" if parameters.turntable else "not asked for (relight.turntable)"
    passes = {"turntable": Decision(parameters.turntable > 0, turning)}
    off = parameters.indirect == "none"
    passes["indirect"] = Decision(not off, "switched off" if off else f"{parameters.indirect}, if the mesh hides any of itself")
    return Decision(True, f"{maps} to light the model with", passes)


def check(capture: Capture) -> None:
    """Raise UserError where a map cannot be used."""
    from .environment_map import read_map

    for path in capture.environments:
        read_map(path)


def _counted(capture: Capture, parameters: RelightParameters) -> str:
    """How many maps there are, and which of them come with the program; and the lights."""
    count = len(capture.environments)
    ours = [path.stem for path in capture.environments if path == shipped_map(path.stem)]
    maps = f"{count} environment map" + ("s" if count > 1 else "")
    maps += f" ({', '.join(ours)} of the program's own)" if ours else ""
    return maps + (f" and the lights of {parameters.lights}" if parameters.lights else "")


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
    version=7,
    parameters=RelightParameters,
    needs=("decode", "poses", "masks", "olat", "train", "mesh"),
    needed=needed,
    run=run,
    check=check,
    config=("up", "olat"),
    given_files=given_files,
    environments=True,
    memory=memory_estimate.relight,
    costs=time_estimate.relight,
    parallel=0.3,
)
