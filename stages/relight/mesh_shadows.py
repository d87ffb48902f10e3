"""Shadows and inter-reflection that the mesh throws on the views' pixels: rays once, every map by matrix products."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from pipeline.geometry.occluder import Occluder, simplified
from pipeline.geometry.world import Y_UP_FROM
from pipeline.shading import Occlusion
from pipeline.shading.sharp_shadows import Points, SharpShadows
from pipeline.shading.transfer import Attachment, SurfaceLight, Transfer

from .deferred import Lamp, ShadingModel, Surface
from .mesh_images import read_baked_mesh

TRANSFER_TEXELS = 16  # along a cube face: what is even of the light has shadows with edges 6 degrees wide
FACES = 20_000  # of the mesh that throws them
NEIGHBOURS = 3  # coarse vertices that a fine one is interpolated from


@dataclass(frozen=True)
class Tied:
    """A view's points in the maps' frame, tied to the mesh."""

    points: Points
    attachment: Attachment


@dataclass(frozen=True)
class MapLight:
    """Light at the mesh's vertices under one map, and the shadows of the map's bright parts."""

    surface: SurfaceLight
    sharp: SharpShadows


class SelfOcclusion:
    """The mesh as an occluder, in the maps' frame (y up), and the views' pixels tied to it."""

    def __init__(self, mesh: Path, model: ShadingModel) -> None:
        from scipy.spatial import cKDTree

        vertices, attributes, faces = read_baked_mesh(mesh)
        self._turn = Y_UP_FROM[model.up]
        self._lobe = model.lobe
        coarse, triangles = simplified(vertices, faces, FACES)
        _, nearest = cKDTree(vertices).query(coarse)
        self._coarse_of_fine = cKDTree(coarse).query(vertices, k=NEIGHBOURS)
        material = attributes[nearest, 3:]
        ior = float(np.median(material[:, 4]))
        occluder = Occluder(coarse @ self._turn.T, triangles)
        self._transfer = Transfer(occluder, material[:, :3], ior=ior, resolution=TRANSFER_TEXELS)

    def under(self, lamp: Lamp) -> MapLight:
        """Light at the mesh's vertices under a map."""
        light = self._transfer.light(lamp.cube)
        return MapLight(light, SharpShadows(self._transfer, light, lamp.light))

    def on_mesh(self, light: MapLight | SurfaceLight) -> NDArray[np.float32]:
        """Shadow and bounced light [V, 6] at the vertices of mesh.ply, from the nearest of the coarse mesh's."""
        light = light.surface if isinstance(light, MapLight) else light
        distance, index = self._coarse_of_fine
        weight = 1 / (distance + 1e-3 * distance.max() + np.finfo(float).tiny)  # a vertex of both meshes takes its own value
        weight /= weight.sum(1, keepdims=True)
        values = torch.cat([light.shadow, light.bounced], 1).numpy()
        return np.einsum("vk,vkc->vc", weight, values[index]).astype(np.float32)

    def surface(self) -> tuple[NDArray, NDArray]:
        """The coarse mesh's vertices and outward normals [V, 3] in the world."""
        mesh = self._transfer.occluder
        return mesh.vertices @ self._turn, mesh.normals @ self._turn

    def lit(self, received: torch.Tensor) -> SurfaceLight:
        """Light at the mesh's vertices that receive [V, 3] (`sampled_light.received`) from lamps that are no map."""
        return self._transfer.lit(received)

    def starts(self, position: NDArray, normal: NDArray) -> NDArray:
        """Where shadow rays of points [P, 3] with unit normals [P, 3] begin: on the mesh, lifted off it."""
        return self._on_mesh(position @ self._turn.T) + self._transfer.occluder.lift * (normal @ self._turn.T)

    def hidden(self, starts: NDArray, directions: NDArray, distances: NDArray) -> NDArray[np.bool_]:
        """Whether the mesh lies between rays' `starts` [R, 3] and what is that far [R] in world directions [R, 3]."""
        return self._transfer.occluder.hidden(starts, directions @ self._turn.T, distances)

    def _on_mesh(self, points: NDArray) -> NDArray:
        """Blended depths lie a little inside the mesh: the nearest points on it."""
        mesh = self._transfer.occluder
        near = mesh.nearest(points)
        return np.einsum("pk,pkc->pc", near.weights, mesh.vertices[near.vertices])

    def attach(self, surface: Surface, own_rays: bool = False, name: str = "") -> Tied:
        """Rays of a view's points: they hold for every map. own_rays: also for diffuse light (`Transfer.attach`)."""
        points, normals, view = (np.asarray(v @ self._turn.T) for v in (surface.position, surface.normal, surface.view))
        points = self._on_mesh(points)
        roughness, ior = surface.material[:, 3], surface.material[:, 4]
        attachment = self._transfer.attach(points, normals, view, roughness, lobe=self._lobe, own_rays=own_rays)
        return Tied(Points.of(points, normals, view, roughness, ior), attachment)

    def at(self, tied: Tied, light: MapLight | SurfaceLight) -> Occlusion:
        """What shading needs at a view's points under one map, or of lamps that are none (`lit`), without their own shadows."""
        if isinstance(light, MapLight):
            return light.sharp.occlusion(tied.points, tied.attachment, light.surface)
        return self._transfer.occlusion(tied.attachment, light)
