"""Parameters of the relight stage."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

from pipeline.optics.model_names import AnchorPlaces, AnchorWeights, Indirect, Mirror


@dataclass(frozen=True)
class RelightParameters:
    """How the model is lit anew."""

    cube: int = field(default=128, metadata={"help": "texels along a side of the map's cube faces, a power of two (texels)"})
    indirect: Literal["auto", Indirect] = field(
        default="auto",
        metadata={
            "help": "light that the mesh hides from and sends to itself: traced (shadows, two bounces), gridmap (PhyGaP's "
            "local environments), sh (what train.indirect=sh has learnt), none; auto: as in training; left out where the mesh "
            "hides nothing"
        },
    )
    gridmap_weights: AnchorWeights = field(
        default="inverse-square", metadata={"help": "weights of GridMap's anchors: 1/d^2, or d as Eq. 9 prints it"}
    )
    gridmap_anchors: AnchorPlaces = field(
        default="box", metadata={"help": "where GridMap's anchors stand: on the bounding box, or close to the surface (10.4)"}
    )
    mirror: Mirror = field(
        default="tree",
        metadata={"help": "mirrored light: the lobe summed over a tree of the map's texels, or over facets; or the split sum"},
    )
    shadow_rays: Literal["vertex", "pixel"] = field(
        default="vertex",
        metadata={
            "help": "shadows of even light by rays of the mesh's vertices, or of every pixel: seconds a view; lamps' "
            "shadows are sharp in either"
        },
    )
    previews: bool = field(default=True, metadata={"help": "write a PNG beside every EXR"})
    turntable: int = field(default=0, metadata={"help": "frames of a turntable of the mesh under every map; 0: none (count)"})
    turntable_size: int = field(default=320, metadata={"help": "width and height of the turntable (px)"})
    lights: str = field(
        default="",
        metadata={"help": "file of directional, spherical and rectangular lights in the capture's world (TOML or JSON)"},
    )
    cameras: str = field(
        default="", metadata={"help": "file of cameras to show the mesh from: transforms.json, or a camera path of nerfstudio"}
    )

    def __post_init__(self) -> None:
        if self.cube not in (16, 32, 64, 128, 256):
            raise ValueError("cube must be 16, 32, 64, 128 or 256")
        if not 0 <= self.turntable <= 1000:
            raise ValueError("turntable must lie between 0 and 1000")
        if not 16 <= self.turntable_size <= 4096:
            raise ValueError("turntable_size must lie between 16 and 4096")
