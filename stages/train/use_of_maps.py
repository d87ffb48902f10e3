"""Whether training takes the maps of a light stage beside the views."""

from __future__ import annotations

from pipeline.capture import Capture
from pipeline.engine.stage import Decision


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
