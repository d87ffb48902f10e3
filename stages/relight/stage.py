"""Relight: the model under other environment maps; a light stage by the sum of its frames and by its fitted maps."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

from pipeline.capture import Capture
from pipeline.engine.stage import Decision, Stage, StageRun

MIN_TRAINING_VIEWS = 8  # as the train stage: fewer have no model


@dataclass(frozen=True)
class RelightParameters:
    """How the model is lit anew."""

    cube: int = field(default=128, metadata={"help": "texels along a side of the map's cube faces, a power of two (texels)"})
    occlusion: Literal["auto", "on", "off"] = field(
        default="auto", metadata={"help": "shadows and one bounce from the mesh; auto: where training modelled them"}
    )
    mirror: Literal["split", "lobe-4", "lobe-12", "lobe-24", "lobe-48"] = field(
        default="lobe-24",
        metadata={"help": "mirrored light: facets summed over the lobe, or the split sum, which blurs alike in all directions"},
    )
    shadow_rays: Literal["vertex", "pixel"] = field(
        default="vertex",
        metadata={"help": "shadows from rays of the mesh's vertices, or of every pixel: sharper, seconds a view"},
    )
    previews: bool = field(default=True, metadata={"help": "write a PNG beside every EXR"})
    turntable: int = field(default=0, metadata={"help": "frames of a turntable of the mesh under every map; 0: none (count)"})
    turntable_size: int = field(default=320, metadata={"help": "width and height of the turntable (px)"})

    def __post_init__(self) -> None:
        if self.cube not in (16, 32, 64, 128, 256):
            raise ValueError("cube must be 16, 32, 64, 128 or 256")
        if not 0 <= self.turntable <= 1000:
            raise ValueError("turntable must lie between 0 and 1000")
        if not 16 <= self.turntable_size <= 4096:
            raise ValueError("turntable_size must lie between 16 and 4096")


def needed(capture: Capture, parameters: RelightParameters) -> Decision:
    """Where there are maps, and something that can be lit."""
    if capture.kind != "light_stage" and len(capture.views) < MIN_TRAINING_VIEWS:
        return Decision(False, f"too few views for a model: {len(capture.views)}, at least {MIN_TRAINING_VIEWS} are needed")
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
    version=3,
    parameters=RelightParameters,
    needs=("decode", "poses", "masks", "olat", "train", "mesh"),
    needed=needed,
    run=run,
    config=("up", "olat"),
    environments=True,
)
