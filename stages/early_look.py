"""What the stages would warn of, from a look at a capture's own pixels, cameras and masks before anything long runs.

The stages that only read (decode, poses with given cameras, masks that are given, and the light stage's evidence) run as they
are (of masks that have to be made, what the cameras alone tell), on the whole of a small capture or on a few views of a large
one, into a folder that is deleted.
"""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.capture import Capture, LightStage
from pipeline.capture.naming.files import count
from pipeline.engine.changes import State
from pipeline.engine.plan import Step
from pipeline.engine.progress import Progress
from pipeline.engine.stage import StageRun
from pipeline.errors import UserError

Task = Callable[[StageRun], None]
FEWEST_VIEWS = 8
"""Looked at however large they are: what training needs, and what one-sidedness is judged by."""
FEWEST_LIGHTS = 4


def look(
    capture: Capture, steps: Sequence[Step], found: Mapping[str, State], megapixels: float
) -> tuple[tuple[str, ...], UserError | None]:
    """Find out what the stages would warn of, before anything long runs.

    Args:
        capture: as recognised.
        steps: its plan.
        found: how each step stands, by stage.
        megapixels: of frames that may be read for it; at least FEWEST_VIEWS views are.

    Returns:
        The warnings of stages that are not done yet, and the fault that a run would end with, if any.
    """
    part, whole = part_of(capture, megapixels * 1e6)
    lines: list[str] = []
    fault: UserError | None = None
    with tempfile.TemporaryDirectory(prefix="polarfield-look-") as folder:
        folders: dict[str, Path] = {}
        for name, task, run in _runs(part, steps, Path(folder), folders, whole):
            try:
                task(run)
            except UserError as error:
                fault = error
            if not found[name].ready:
                lines += run.warnings
            if fault is not None:
                break
            folders[name] = run.output
    where = "" if whole else f" (seen in {_share(part, capture)})"
    said = tuple(f"{line}{where}" for line in dict.fromkeys(lines))
    if fault is not None and not whole:  # it may be of a part alone, as masks that are empty in these views
        return (*said, f"{fault}{where}"), None
    return said, fault


def _share(part: Capture, capture: Capture) -> str:
    if part.light_stage is not None and capture.light_stage is not None:
        used = len(next(iter(part.light_stage.cameras.values())).cross)
        return f"the frames of {used} of {len(capture.light_stage.lights)} lights"
    return f"{len(part.views)} of {count(capture.views, 'view')}"


def part_of(capture: Capture, pixels: float) -> tuple[Capture, bool]:
    """The capture, or evenly chosen views or lights of it that come to about so many pixels; and whether it is all of it."""
    if capture.light_stage is not None:
        return _lights_of(capture, capture.light_stage, pixels)
    if capture.olat is not None and not part_of(capture.olat, pixels)[1]:
        capture = replace(capture, olat=None)  # the views tell more, and the light stage alone is too large
    sizes = [view.size or _camera_size(capture, view.view) for view in capture.views]
    each = max((w * h * len(view.paths) for (w, h), view in zip(sizes, capture.views)), default=1)
    most = max(FEWEST_VIEWS, int(pixels / max(each, 1)))
    if len(capture.views) <= most:
        return capture, True
    views = tuple(capture.views[k] for k in np.unique(np.linspace(0, len(capture.views) - 1, most).round().astype(int)))
    names = {view.view for view in views}
    masks = {k: v for k, v in capture.masks.items() if k in names} if isinstance(capture.masks, dict) else capture.masks
    cameras = None if capture.cameras is None else {k: v for k, v in capture.cameras.items() if k in names}
    parts = None if capture.parts is None else {k: v for k, v in capture.parts.items() if k in names}
    return replace(capture, views=views, masks=masks, cameras=cameras, parts=parts, colmap=None), False


def _camera_size(capture: Capture, view: str) -> tuple[int, int]:
    camera = (capture.cameras or {}).get(view)
    return (camera.width, camera.height) if camera else (1024, 1024)


def _lights_of(capture: Capture, stage: LightStage, pixels: float) -> tuple[Capture, bool]:
    each = 2 * sum(c.camera.width * c.camera.height for c in stage.cameras.values())
    most = max(FEWEST_LIGHTS, int(pixels / max(each, 1)))
    if len(stage.lights) <= most:
        return capture, True
    chosen = np.unique(np.linspace(0, len(stage.lights) - 1, most).round().astype(int))
    cameras = {
        name: replace(c, cross=tuple(c.cross[k] for k in chosen), parallel=tuple(c.parallel[k] for k in chosen))
        for name, c in stage.cameras.items()
    }
    return replace(capture, light_stage=replace(stage, cameras=cameras)), False


def _runs(
    capture: Capture, steps: Sequence[Step], folder: Path, folders: dict[str, Path], whole: bool
) -> Iterator[tuple[str, Task, StageRun]]:
    """What can be run early, in order: each stage's name, what runs of it, and with what it is run."""
    for step in steps:
        found = _task(capture, step, whole) if step.decision.run else None
        if found is None:
            continue
        task, parameters = found
        name = step.stage.name
        output, scratch = folder / name, folder / f"{name}-scratch"
        output.mkdir()
        scratch.mkdir()
        inputs = {needed: folders[needed] for needed in step.stage.needs if needed in folders}
        jobs = os.cpu_count() or 1
        quiet = Progress(quiet=True)
        yield name, task, StageRun(capture, parameters, inputs, output, scratch, progress=quiet, jobs=jobs, partial=not whole)


def _task(capture: Capture, step: Step, whole: bool) -> tuple[Task, Any] | None:
    """What of a stage is quick to run, and with which parameters; None where nothing is."""
    name, parameters, run = step.stage.name, step.parameters, step.stage.run
    if name == "decode":
        return run, parameters
    if name == "poses" and capture.cameras is not None:
        return run, replace(parameters, triangulate=False)
    if name == "masks" and (whole if capture.kind == "light_stage" else _masks_are_given(capture, parameters)):
        return run, parameters
    if name == "masks" and capture.kind == "multiview" and capture.cameras is not None:
        return _look_at_cameras, parameters
    if name == "relight":
        return _look_at_maps, parameters
    if name == "olat" and whole and capture.one_light_at_a_time.light_stage is not None:
        from stages.olat.evidence.early import check_early

        return check_early, parameters
    return None


def _look_at_cameras(run: StageRun) -> None:
    from stages.masks.agreement import say_if_pictures_do_not_fit
    from stages.masks.run import say_if_one_sided

    say_if_one_sided(run)
    if run.parameters.hull_check:
        say_if_pictures_do_not_fit(run, {})


def _look_at_maps(run: StageRun) -> None:
    from stages.relight.environment_map import read_map

    for path in run.capture.environments:
        for fault in read_map(path)[1]:
            run.warn(fault)


def _masks_are_given(capture: Capture, parameters: Any) -> bool:
    """Whether cameras are and no view has to be segmented."""
    from stages.masks.parameters import choose_method

    method, _ = choose_method(capture, parameters)
    every = not isinstance(capture.masks, dict) or {view.view for view in capture.views} <= set(capture.masks)
    return capture.cameras is not None and method in ("given", "alpha", "none") and every
