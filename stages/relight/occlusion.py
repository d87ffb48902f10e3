"""Shadows and inter-reflection that the mesh throws on the views' pixels: rays once, every map by matrix products."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from pipeline.lighting import Occlusion
from pipeline.lighting.occluder import Occluder, simplified
from pipeline.lighting.visibility import Attachment, SurfaceLight, Transfer
from pipeline.lights.environment import Y_UP_FROM

from .deferred import Lamp, ShadingModel, Surface
from .turntable import read_ply

TRANSFER_TEXELS = 16  # along a cube face: shadows' edges are 6 degrees wide
FACES = 20_000  # of the mesh that throws them
NEIGHBOURS = 3  # coarse vertices that a fine one is interpolated from

SMOOTHING = 12  # rounds of Taubin smoothing: the ripple of fused depths must not shadow itself
LIFT_EDGES = 0.75  # rays start this many edges of mesh.ply (about its voxels) off the surface, above what ripple is left


def smoothed(vertices: NDArray, faces: NDArray) -> NDArray[np.float64]:
    """Vertices [V, 3] after Taubin smoothing, which does not shrink."""
    import open3d as o3d

    mesh = o3d.geometry.TriangleMesh(
        o3d.utility.Vector3dVector(np.asarray(vertices, np.float64)), o3d.utility.Vector3iVector(faces.astype(np.int32))
    )
    return np.asarray(mesh.filter_smooth_taubin(SMOOTHING).vertices)


def median_edge(vertices: NDArray, faces: NDArray) -> float:
    """Median length of the triangles' first edges."""
    return float(np.median(np.linalg.norm(vertices[faces[:, 0]] - vertices[faces[:, 1]], axis=1)))


class SelfOcclusion:
    """The mesh as an occluder, in the maps' frame (y up), and the views' pixels tied to it."""

    def __init__(self, mesh: Path, model: ShadingModel) -> None:
        from scipy.spatial import cKDTree

        vertices, attributes, faces = read_ply(mesh)
        self._turn = Y_UP_FROM[model.up]
        self._lobe = model.lobe
        coarse, triangles = simplified(smoothed(vertices, faces), faces, FACES)
        _, nearest = cKDTree(vertices).query(coarse)
        self._coarse_of_fine = cKDTree(coarse).query(vertices, k=NEIGHBOURS)
        material = attributes[nearest, 3:]
        ior = float(np.median(material[:, 4]))
        occluder = Occluder(coarse @ self._turn.T, triangles)
        occluder.lift = max(occluder.lift, LIFT_EDGES * median_edge(vertices, faces))
        self._transfer = Transfer(occluder, material[:, :3], ior=ior, resolution=TRANSFER_TEXELS)
        self._attached: dict[str, Attachment] = {}

    def under(self, lamp: Lamp) -> SurfaceLight:
        """Light at the mesh's vertices under a map."""
        return self._transfer.light(lamp.cube)

    def on_mesh(self, light: SurfaceLight) -> NDArray[np.float32]:
        """Shadow and bounced light [V, 6] at the vertices of mesh.ply, from the nearest of the coarse mesh's."""
        distance, index = self._coarse_of_fine
        weight = 1 / (distance + 1e-3 * distance.max() + np.finfo(float).tiny)  # a vertex of both meshes takes its own value
        weight /= weight.sum(1, keepdims=True)
        values = torch.cat([light.shadow, light.bounced], 1).numpy()
        return np.einsum("vk,vkc->vc", weight, values[index]).astype(np.float32)

    def at(self, name: str, surface: Surface, light: SurfaceLight) -> Occlusion:
        """What shading needs at a view's points; the rays of a named view are cast once."""
        attachment = self._attached.get(name)
        if attachment is None:
            points, normals, view = (np.asarray(v @ self._turn.T) for v in (surface.position, surface.normal, surface.view))
            near = self._transfer.occluder.nearest(points)  # blended depths lie a little inside the mesh: rays start on it
            points = np.einsum("pk,pkc->pc", near.weights, self._transfer.occluder.vertices[near.vertices])
            attachment = self._transfer.attach(points, normals, view, surface.material[:, 3], lobe=self._lobe)
            self._attached[name] = attachment
        return self._transfer.occlusion(attachment, light)
