"""Deferred shading of points under one map: positions and material in, Stokes vectors out (torch)."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from pipeline.geometry.world import Y_UP_FROM
from pipeline.shading import LightField, Prefilter, latlong, shade


@dataclass(frozen=True)
class Surface:
    """P surface points seen by a camera, world frame: unit normals and directions to the camera [P, 3], material, frame.

    material [P, 5]: albedo R G B, roughness, ior. frame_x, frame_y [P, 3]: each pixel's Stokes axes; pixels [P]: their
    flat indices in a view.
    """

    position: NDArray
    normal: NDArray
    view: NDArray
    material: NDArray
    frame_x: NDArray
    frame_y: NDArray
    pixels: NDArray[np.int64] | None = None

    def part(self, rows: slice | NDArray[np.int64]) -> Surface:
        """Some of the points."""
        pixels = None if self.pixels is None else self.pixels[rows]
        images = (self.position, self.normal, self.view, self.material, self.frame_x, self.frame_y)
        position, normal, view, material, frame_x, frame_y = (values[rows] for values in images)
        return Surface(position, normal, view, material, frame_x, frame_y, pixels)


@dataclass(frozen=True)
class ShadingModel:
    """How training shaded (its lighting.json), and how finely relighting samples the mirrored lobe (`shade`'s mirror)."""

    up: str = "y"
    fresnel: str = "exact"
    lobe: str = "ggx"
    occlusion: bool = False
    indirect: str = "none"
    mirror: str = "split"

    @classmethod
    def read(cls, path: Path, up: str, mirror: str = "split") -> ShadingModel:
        """From lighting.json; what it does not say keeps its default. Schlick's Fresnel term knows the split sum alone."""
        import json

        facts = json.loads(path.read_text()) if path.exists() else {}
        known = {k: facts[k] for k in ("fresnel", "lobe", "occlusion", "indirect") if k in facts}
        known.setdefault("indirect", "traced" if known.get("occlusion") else "none")  # of a training that knew one kind alone
        return cls(up=facts.get("up", up), mirror=mirror if facts.get("fresnel") != "schlick" else "split", **known)


class Lamp:
    """One environment map, prefiltered."""

    def __init__(self, radiance: NDArray[np.float32], resolution: int, model: ShadingModel) -> None:
        cube = torch.as_tensor(latlong.to_cube(radiance, resolution), dtype=torch.float32)
        self.model = model
        self.cube = cube
        self.light: LightField = Prefilter(resolution, model.lobe).apply(cube)
        self._turn = Y_UP_FROM[model.up]  # maps are y up

    def turned(self, vectors: NDArray) -> torch.Tensor:
        """World vectors [P, 3] in the map's frame."""
        return torch.as_tensor(np.ascontiguousarray(vectors @ self._turn.T, np.float32))

    def stokes(self, surface: Surface, occlusion: Any = None) -> NDArray[np.float32]:
        """Stokes vectors [P, 3, 3 rgb] of the points' radiance."""
        material = torch.as_tensor(np.ascontiguousarray(surface.material, np.float32))
        with torch.no_grad():
            shaded = shade(
                self.turned(surface.normal),
                self.turned(surface.view),
                material[:, :3].contiguous(),
                material[:, 3].contiguous(),
                material[:, 4].contiguous(),
                self.turned(surface.frame_x),
                self.turned(surface.frame_y),
                self.light,
                occlusion=occlusion,
                fresnel=self.model.fresnel,
                mirror=self.model.mirror,
            )
        return shaded.stokes.numpy()
