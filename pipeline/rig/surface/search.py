"""The closed surface on which all cameras' normals and albedos agree, in the order of work."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import UserError
from pipeline.geometry.cameras import Camera
from pipeline.geometry.mesh import Mesh, in_fixed_order, largest_pieces, without_slivers
from pipeline.geometry.rays import RayMesh
from pipeline.rig.surface.belief import believed
from pipeline.rig.surface.depths import find_depths, supports
from pipeline.rig.surface.read_maps import Rig
from pipeline.rig.surface.volume import chords, extracted, fused_volume, hull_of, silhouettes_of

HULL = 128  # voxels along the longest side of the hull: it bounds the search, the surface is finer
SLACK = 1.5  # pixel footprints by which depths of one surface differ between cameras
TRUNCATION = 3.0  # voxels: depths agree to a fraction of one, and what is farther behind a surface is another part


@dataclass(frozen=True)
class SurfaceSettings:
    """How finely.

    Fields:
        voxel_px: a voxel's edge, in pixel footprints.
        max_voxels: along the longest side, at most.
        grazing: least cosine between ray and normal of a distance that counts.
        smallest_piece: share of the largest piece's area below which others go.
    """

    voxel_px: float = 1.2
    max_voxels: int = 320
    grazing: float = 0.15
    smallest_piece: float = 0.02


def find_surface(rig: Rig, settings: SurfaceSettings, say: Callable[[str], None]) -> tuple[Mesh, float]:
    """Find the closed surface before its fine relief.

    Args:
        rig: the cameras with their maps.
        settings: how finely.
        say: told what is going on.

    Returns:
        The surface, and its voxel's edge (world units).

    Raises:
        UserError: a camera has no normal, or the maps have no surface in common.
    """
    views = rig.views(settings.max_voxels)
    if empty := [v.name for v in views if not v.known.any()]:
        raise UserError(rig.folder, f"no pixel of {', '.join(empty)} has a normal", "look at its preview.png")
    hull = hull_of(silhouettes_of(views), HULL)
    low, high = hull.box()
    foot = footprint([view.camera for view in views], 0.5 * (low + high))
    voxel = max(settings.voxel_px * foot, float((high - low).max()) / settings.max_voxels)
    spans = [chords(view, hull) for view in views]
    say("looking for the surface on which the cameras' normals agree")
    known = None
    for _ in range(2):  # the second time every camera sets out from what all of them made
        distances = find_depths(views, spans, known)
        distances = believed(views, distances, supports(views, distances), spans, SLACK * foot)
        field, corner = fused_volume(views, distances, hull, voxel, TRUNCATION * voxel, settings.grazing)
        mesh = largest_pieces(without_slivers(extracted(field, corner, voxel)), settings.smallest_piece)
        if not len(mesh.faces):
            raise UserError(rig.folder, "the cameras' maps share no surface", "check the masks and the cameras")
        solid = RayMesh(mesh.vertices, mesh.faces)
        known = [solid.distance(view.camera.centre, view.camera.rays()).astype(np.float64) for view in views]
    return in_fixed_order(mesh), voxel


def footprint(cameras: Sequence[Camera], centre: NDArray) -> float:
    """Measure a pixel's usual width at the object.

    Args:
        cameras: that see it.
        centre: of the object. [3]

    Returns:
        The median over the cameras, world units.
    """
    return float(np.median([np.linalg.norm(c.centre - centre) / np.sqrt(c.fx * c.fy) for c in cameras]))
