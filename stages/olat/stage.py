"""Olat: one-light-at-a-time frames behind crossed and parallel polarisers to reflectance maps."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from pipeline.capture import Capture
from pipeline.capture.view_rules import FEWEST_CAMERAS
from pipeline.engine.costs import Cost
from pipeline.engine.progress import brief
from pipeline.engine.stage import Decision, Stage, StageRun
from stages import memory_estimate, time_estimate
from stages.olat.parameters import OlatParameters


def needed(capture: Capture, parameters: OlatParameters) -> Decision:
    """Where the capture is a light stage."""
    capture = capture.one_light_at_a_time
    stage = capture.light_stage
    if stage is None:
        return Decision(False, "no one-light-at-a-time frames")
    near = capture.config.olat.near_light
    passes = {
        "overexposure": Decision(
            parameters.overexposure != "off", "on the samples that decode finds clipped, if any"
            if parameters.overexposure != "off" else "olat.overexposure=off"
        ),
        "near light": Decision(near, "near_light is set" if near else "lights are distant (near_light is not set)"),
        "jax": Decision(
            parameters.solver not in ("closed", "gradient"), f"solver {parameters.solver}"
        ),
    }  # fmt: skip
    cameras = f"{len(stage.cameras)} camera{'s' * (len(stage.cameras) != 1)}"
    passes["second fit"] = second_fit(capture, parameters)
    passes["pixels outside the masks"] = Decision(False, "only pixels of the object are fitted")
    return Decision(True, f"{cameras} under {len(stage.lights)} lights, cross and parallel", passes)


def second_fit(capture: Capture, parameters: OlatParameters) -> Decision:
    """Whether the fits are redone with the surface that they show."""
    count = len(capture.light_stage.cameras) if capture.light_stage is not None else 0
    if parameters.second_fit == "off":
        return Decision(False, "olat.second_fit=off")
    if parameters.geometry:
        return Decision(False, "the shape is given (olat.geometry)")
    if count < FEWEST_CAMERAS:
        return Decision(False, f"a surface needs {FEWEST_CAMERAS} cameras")
    cost = time_estimate.olat(capture, parameters, compiled=True)["second fit"]
    about = f" (adds about {brief(cost.cpu_s)} of one core, {cost.memory_mb:.0f} MB)"
    if parameters.second_fit == "on":
        return Decision(True, f"olat.second_fit=on{about}")
    if capture.config.olat.near_light:
        return Decision(True, f"near lights stand elsewhere for each point of the surface, which the first fits show{about}")
    return Decision(False, "lights are distant, and the fits tell shadows by themselves (olat.second_fit=on does it)")


def capture_files(capture: Capture) -> Iterable[Path]:
    """The frames themselves: decode leaves only an index of them."""
    stage = capture.one_light_at_a_time.light_stage
    if stage is None:
        return []
    return [path for camera in stage.cameras.values() for path in camera.frames]


def given_files(capture: Capture, parameters: OlatParameters) -> tuple[Path, ...]:
    """The mesh that `geometry` names, if any. Raises UserError where it is none."""
    from stages.olat.known_geometry import geometry_file

    found = geometry_file(capture.one_light_at_a_time, parameters.geometry) if parameters.geometry else None
    return () if found is None else (found,)


def memory(capture: Capture, parameters: OlatParameters, jobs: int) -> float:
    """MiB at its peak."""
    capture = capture.one_light_at_a_time
    again = second_fit(capture, parameters).run
    return memory_estimate.olat(capture, parameters, jobs, _compiled(capture, parameters), again)


def costs(capture: Capture, parameters: OlatParameters) -> dict[str, Cost]:
    """What it takes, with what its passes take."""
    capture = capture.one_light_at_a_time
    if capture.light_stage is None:
        return time_estimate.olat(capture, parameters, compiled=True)
    return time_estimate.olat(capture, parameters, _compiled(capture, parameters))


def _compiled(capture: Capture, parameters: OlatParameters) -> bool:
    """Whether the fits' machine code is kept for such frames."""
    from stages.olat.pixel_fit.many_pixels import ready

    assert capture.light_stage is not None
    half = all(c.cross and c.cross[0].suffix.lower() == ".exr" for c in capture.light_stage.cameras.values())
    return ready(half, parameters.precision)


def run(stage: StageRun) -> None:
    """Write camNN/ with its maps and preview.png for every camera."""
    from stages.olat.reading.stream import reading
    from stages.olat.zoo.solvers import SOLVERS, check_installed

    stage = stage.of_light_stage()
    if stage.parameters.solver in SOLVERS:
        check_installed(stage.parameters.solver)
    if second_fit(stage.capture, stage.parameters).run:
        from stages.olat.second_fit import fit_twice

        fit_twice(stage)
        return
    with reading(stage) as lanes:
        from stages.olat.run import run as fit_all  # the frames are on their way meanwhile

        fit_all(stage, lanes)


STAGE = Stage(
    name="olat",
    version=15,
    parameters=OlatParameters,
    needs=("decode", "masks"),
    needed=needed,
    run=run,
    capture_files=capture_files,
    config=("olat", "radiometry"),
    given_files=given_files,
    memory=memory,
    costs=costs,
    parallel=0.8,
)
