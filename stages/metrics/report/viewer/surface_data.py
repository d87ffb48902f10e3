"""The mesh as the viewer draws it: few enough triangles, a few bytes a vertex, y up."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.asset.ambient import sky_seen
from pipeline.formats.images import srgb_encode
from pipeline.formats.ply import Ply
from pipeline.geometry.rays import RayMesh

from .packing import octahedral, packed
from .textured_surface import textured_surface

TRIANGLES = 60_000
"""Drawn at most: a software renderer's vertex stage takes a few milliseconds for them."""
LIFT = 0.5  # of an edge, above the surface, at which rays to the sky begin: facets are not as smooth as normals are
ATTRIBUTES = ("nx", "ny", "nz", "albedo_r", "albedo_g", "albedo_b", "roughness", "ior")
IOR_RANGE = (1.0, 2.6)  # the split-sum table's; a byte steps by 0.006


def surface_entry(path: Path, turn: NDArray[np.float64], asset: Path | None = None) -> dict[str, Any]:
    """A baked mesh as packed arrays. Raises UserError where the file is none.

    path: `mesh.ply` of the mesh stage; turn [3, 3]: to the y-up frame; asset: the folder with the same surface in an atlas,
    which is taken where it is there and small enough. `position` uint16 over the box from `low` to `high`, `normal`
    octahedral, `albedo` in sRGB bytes, `material` bytes of roughness, IoR over `ior_range` and share of the sky seen, `index`
    of the corners; of an atlas `uv` (uint16 over 0..1), `tangent` (octahedral, and the third axis' sign) and `pictures`.
    """
    textured = None if asset is None else textured_surface(asset, TRIANGLES)
    if textured is not None:
        t = textured
        entry = _entry(t.position, t.normal, t.albedo, t.roughness, t.ior, t.faces)
        tangent = np.concatenate([octahedral(t.tangent[:, :3]), np.where(t.tangent[:, 3:] < 0, -32767, 32767)], 1)
        uv = np.rint(np.clip(t.uv, 0, 1) * 65535).astype(np.uint16)
        entry |= {"uv": packed(uv), "tangent": packed(tangent.astype(np.int16)), "pictures": t.pictures}
        return {**entry, "of": len(t.faces)}
    ply = Ply(path)
    vertices, faces = ply.vertices(), ply.triangles()
    attributes = ply.vertices(ATTRIBUTES)
    total = len(faces)
    vertices, a, faces = thinned(vertices, attributes, faces, TRIANGLES)
    return {**_entry(vertices @ turn.T, a[:, :3] @ turn.T, a[:, 3:6], a[:, 6], a[:, 7], faces), "of": total}


def _entry(
    position: NDArray, normal: NDArray, albedo: NDArray, roughness: NDArray, ior: NDArray, faces: NDArray
) -> dict[str, Any]:
    """What every surface has."""
    low, high = position.min(0), position.max(0)
    share = (position - low) / np.maximum(high - low, 1e-30)
    edges = np.linalg.norm(position[faces[:, 0]] - position[faces[:, 1]], axis=1)
    sky = sky_seen(RayMesh(position, faces), position, normal, LIFT * float(np.median(edges)))
    material = np.stack([roughness, (ior - IOR_RANGE[0]) / (IOR_RANGE[1] - IOR_RANGE[0]), sky], -1)
    return {
        "mean_albedo": float(albedo.mean()),
        "low": low.tolist(), "high": high.tolist(), "triangles": len(faces), "ior_range": IOR_RANGE,
        "position": packed(np.rint(share * 65535).astype(np.uint16)),
        "normal": packed(octahedral(normal)),
        "albedo": packed(_bytes(srgb_encode(np.clip(albedo, 0, 1)))),
        "material": packed(_bytes(material)),
        "index": packed(faces.astype(np.uint16 if len(position) <= 65536 else np.uint32)),
    }  # fmt: skip


def _bytes(share: NDArray) -> NDArray[np.uint8]:
    return np.rint(np.clip(share, 0, 1) * 255).astype(np.uint8)


def thinned(vertices: NDArray, attributes: NDArray, faces: NDArray, most: int) -> tuple[NDArray, NDArray, NDArray]:
    """A mesh of at most about `most` triangles, by quadric errors (Garland and Heckbert 1997), with attributes [V, C] of the
    closest points of the given one: vertices [V, 3], attributes, faces [F, 3]."""
    if len(faces) <= most:
        return vertices, attributes, faces
    import open3d

    o3d: Any = open3d
    middle, size = (vertices.min(0) + vertices.max(0)) / 2, float(np.ptp(vertices, axis=0).max()) or 1.0
    scaled = (vertices - middle) / size  # the library measures in absolute numbers
    mesh = o3d.geometry.TriangleMesh(o3d.utility.Vector3dVector(scaled), o3d.utility.Vector3iVector(faces.astype(np.int32)))
    few = mesh.simplify_quadric_decimation(most)
    points, corners = np.asarray(few.vertices), np.asarray(few.triangles)
    if not len(corners):
        return vertices, attributes, faces
    closest = RayMesh(scaled, faces).closest(points)
    values = np.einsum("nk,nkc->nc", closest.weights, attributes[faces[closest.triangle]])
    values[:, :3] /= np.maximum(np.linalg.norm(values[:, :3], axis=1, keepdims=True), 1e-12)
    return points * size + middle, values, corners
