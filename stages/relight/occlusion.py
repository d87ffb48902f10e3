"""Shadows and inter-reflection that the mesh throws on the views' pixels: rays once, every map by matrix products."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from pipeline.lighting import Occlusion
from pipeline.lighting.occluder import Occluder, simplified
from pipeline.lighting.visibility import Attachment, SurfaceLight, Transfer
from pipeline.lights.environment import Y_UP_FROM

from .deferred import Lamp, ShadingModel, Surface
from .turntable import read_ply

TRANSFER_TEXELS = 16  # along a cube face: shadows' edges are 6 degrees wide
FACES = 20_000  # of the mesh that throws them


class SelfOcclusion:
    """The mesh as an occluder, in the maps' frame (y up), and the views' pixels tied to it."""

    def __init__(self, mesh: Path, model: ShadingModel) -> None:
        from scipy.spatial import cKDTree

        vertices, attributes, faces = read_ply(mesh)
        self._turn = Y_UP_FROM[model.up]
        self._lobe = model.lobe
        coarse, triangles = simplified(vertices, faces, FACES)
        _, nearest = cKDTree(vertices).query(coarse)
        material = attributes[nearest, 3:]
        ior = float(np.median(material[:, 4]))
        self._transfer = Transfer(
            Occluder(coarse @ self._turn.T, triangles), material[:, :3], ior=ior, resolution=TRANSFER_TEXELS
        )
        self._attached: dict[str, Attachment] = {}

    def under(self, lamp: Lamp) -> SurfaceLight:
        """Light at the mesh's vertices under a map."""
        return self._transfer.light(lamp.cube)

    def at(self, name: str, surface: Surface, light: SurfaceLight) -> Occlusion:
        """What shading needs at a view's points; the rays of a named view are cast once."""
        attachment = self._attached.get(name)
        if attachment is None:
            points, normals, view = (np.asarray(v @ self._turn.T) for v in (surface.position, surface.normal, surface.view))
            attachment = self._transfer.attach(points, normals, view, surface.material[:, 3], lobe=self._lobe)
            self._attached[name] = attachment
        return self._transfer.occlusion(attachment, light)
