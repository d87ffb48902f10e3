"""How far each camera's maps are from the fused ones: the error figure that needs no truth."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pipeline.formats.images import write_exr
from pipeline.geometry.mesh import Mesh
from pipeline.geometry.rays import RayMesh
from pipeline.rig.surface.read_maps import RigMaps

Image = NDArray[np.float32]
NAMES = ("normal_deg", "diffuse_albedo", "specular_albedo", "sigma")
"""Channels: degrees between the normals, and differences over the fused value."""


def disagreement(maps: RigMaps, mesh: Mesh, solid: RayMesh) -> dict[str, Image]:
    """A camera's maps against the fused ones [H, W] by channel, 0 where it fits nothing or where it alone sees the surface."""
    camera = maps.camera
    found = solid.cast(camera.centre, camera.rays())
    seen = found.hit & maps.sound
    corners, weights = mesh.faces[found.triangle[seen]], found.weights[seen]

    def fused(name: str) -> NDArray[np.float64]:
        values = mesh.attributes[name].astype(np.float64).reshape(len(mesh.vertices), -1)
        return np.einsum("pk,pkc->pc", weights, values[corners])

    shared = fused("coverage")[:, 0] > 1.5
    normal = fused("normal")
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-9)
    own = {name: maps.maps[name][seen].astype(np.float64) for name in ("normal", "diffuse_albedo", "specular_albedo", "sigma")}
    angle = np.degrees(np.arccos(np.clip((own["normal"] * normal).sum(1), -1, 1)))
    lobed = maps.lobed[seen]
    rows = {"normal_deg": angle}
    for name, attribute in (("diffuse_albedo", "albedo"), ("specular_albedo", "specular"), ("sigma", "sigma")):
        there = fused(attribute)
        size = np.maximum(there.mean(1), 1e-6)
        miss = np.sqrt(((own[name] - there) ** 2).mean(1)) / size
        rows[name] = miss if name == "diffuse_albedo" else np.where(lobed & (there.mean(1) > 0), miss, 0.0)
    out = {}
    for name in NAMES:
        out[name] = np.zeros(maps.mask.shape, np.float32)
        out[name][seen] = np.where(shared, np.minimum(rows[name], 1e3), 0.0)
    return out


def write_disagreement(path: Path, images: dict[str, Image], maps: RigMaps) -> None:
    """Write them in the camera's whole frame. Raises UserError."""
    width, height = maps.size
    left, top = maps.origin
    whole = {}
    for name, image in images.items():
        whole[name] = np.zeros((height, width), np.float32)
        whole[name][top : top + image.shape[0], left : left + image.shape[1]] = image
    write_exr(path, whole)
