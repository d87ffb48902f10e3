"""The light stage beside a capture's views: what of a run is its own, and whether training takes its maps."""

from __future__ import annotations

from dataclasses import replace

from pipeline.capture import Capture
from pipeline.engine.stage import Decision, StageRun
from pipeline.formats.dataset_files import OLAT


def light_stage_run(run: StageRun) -> StageRun:
    """Make a run that is of the light stage alone.

    Args:
        run: of any capture.

    Returns:
        The same run; of a capture of views and a light stage, that of the light stage, whose masks lie in `masks/olat/`.
    """
    if run.capture.olat is None:
        return run
    inputs = {name: folder / OLAT if name == "masks" else folder for name, folder in run.inputs.items()}
    return replace(run, capture=run.capture.olat, inputs=inputs)


def maps_in_training(capture: Capture, wanted: str) -> Decision:
    """Decide whether the maps of a light stage beside the views are priors in training.

    Args:
        capture: as recognised.
        wanted: `train.olat_priors`.

    Returns:
        Whether, and why.
    """
    if capture.olat is None:
        return Decision(False, "no light stage beside the views")
    if wanted == "off":
        return Decision(False, "train.olat_priors=off")
    if capture.cameras is None:
        return Decision(False, "the views' cameras are found, in a world that is not the light stage's: give them")
    count = len(capture.olat.camera_names)
    return Decision(True, f"the light stage's maps of {count} camera{'s' * (count != 1)}: normals, albedo, roughness")
