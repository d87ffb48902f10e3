"""Parameters of the masks stage, and the method that they come to for a capture."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

from pipeline.capture import Capture


@dataclass(frozen=True)
class MasksParameters:
    """How the object is told from the background where nothing is given."""

    method: Literal["auto", "given", "alpha", "clean_plate", "background", "matte", "sam", "none"] = field(
        default="auto", metadata={"help": "auto: given, else alpha, clean plate, SAM checkpoint, background model"}
    )
    sam_checkpoint: str | None = field(
        default=None, metadata={"help": "folder of a Segment-Anything model (transformers' save_pretrained)"}
    )
    prompt: Literal["points", "box"] = field(default="points", metadata={"help": "what SAM is prompted with"})
    hull_check: bool = field(default=True, metadata={"help": "hold masks, given cameras and pictures against each other"})
    max_size: int = field(default=480, metadata={"help": "segmentation works at this longer side (px), edges at full size"})


def choose_method(capture: Capture, parameters: MasksParameters) -> tuple[str, str]:
    """Choose how a capture's masks are made.

    Args:
        capture: as recognised.
        parameters: of the stage; a method other than "auto" is taken.

    Returns:
        The method and the reason for it.
    """
    if parameters.method != "auto":
        return parameters.method, f"masks.method={parameters.method}"
    if capture.kind == "light_stage":
        stage = capture.light_stage
        assert stage is not None
        given = all(camera.mask is not None for camera in stage.cameras.values())
        return (
            ("given", "the light stage has a mask for every camera") if given else ("matte", "matte from the sum of all lights")
        )
    if isinstance(capture.masks, dict):
        return "given", "masks are given"
    if capture.masks == "alpha":
        return "alpha", "the images carry alpha"
    if parameters.sam_checkpoint:
        return "sam", "a Segment-Anything checkpoint is given"
    if capture.clean_plates:
        return "clean_plate", "photographs of the empty scene are there"
    return "background", "no masks: the object is segmented by what all views agree on"
