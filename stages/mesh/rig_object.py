"""A light stage's mesh: surface from masks and normals of all cameras, their maps fused on its vertices."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from pipeline.asset.ambient import sky_seen
from pipeline.engine.stage import StageRun
from pipeline.errors import UserError
from pipeline.formats import dataset_files as files
from pipeline.formats.images import srgb_encode
from pipeline.formats.ply import write_ply
from pipeline.geometry.cameras import Camera
from pipeline.geometry.rays import RayMesh
from pipeline.rig.object_rendering import LOBE

from .clean import Mesh, in_fixed_order, largest_pieces, subdivided, without_slivers
from .refine import following_normals
from .rig_surface.atlas_maps import STANDARD_DEVIATIONS, write_rig_asset
from .rig_surface.belief import believed
from .rig_surface.depths import find_depths, supports
from .rig_surface.disagreement import disagreement, write_disagreement
from .rig_surface.read_maps import Rig
from .rig_surface.sights import Sight, Sights
from .rig_surface.surface import chords, extracted, fused_volume, hull_of, silhouettes_of
from .rig_surface.unseen import smoothed_where_unseen
from .rig_surface.vertex_maps import SurfacePoints, camera_values, filled, fused_maps

HULL = 128  # voxels along the longest side of the hull: it bounds the search, the surface is finer
SLACK = 1.5  # pixel footprints by which depths of one surface differ between cameras
SEEN_WITHIN = 3.0  # voxels: what a camera sees beyond that is another surface
MOST_TRIANGLES = 1_000_000  # beyond it textures alone hold the detail
TRUNCATION = 3.0  # voxels: depths agree to a fraction of one, and what is farther behind a surface is another part


def make_rig_mesh(run: StageRun) -> None:
    """Find the surface, fuse the maps on it, write mesh.ply, asset/ and how far the cameras disagree. Raises UserError."""
    rig, p = Rig(run), run.parameters
    mesh, voxel = find_surface(run, rig)
    slack = SEEN_WITHIN * voxel
    for finer in (False, True):  # every pixel's normal is measured: half a pixel between vertices carries it without blur
        mesh = subdivided(mesh) if finer and 4 * len(mesh.faces) <= MOST_TRIANGLES else mesh
        mesh = smoothed_where_unseen(with_maps(mesh, Sights(rig, mesh), slack))
        mesh = following_normals(mesh, p.follow_normals) if p.follow_normals else mesh
    mesh = in_fixed_order(Mesh(mesh.vertices, mesh.faces))
    sights = Sights(rig, mesh)
    mesh = with_maps(mesh, sights, slack)
    mesh.attributes["occlusion"] = sky_seen(sights.solid, mesh.vertices, mesh.normals(), voxel)
    write_ply(run.output / files.MESH, vertex_table(mesh), mesh.faces, comments=[LOBE + rig.lobe])
    for sight in sights:
        _tell_disagreement(run, sight, mesh, sights.solid)
    run.note("lobe", rig.lobe)
    run.note("voxel", voxel)
    run.note("size", float(np.ptp(mesh.vertices, axis=0).max()))
    run.note("triangles", len(mesh.faces))
    run.note("vertices_seen", round(float((mesh.attributes["coverage"] > 0).mean()), 4))
    if p.textures:
        finest = footprint([sight.maps.camera for sight in sights], mesh.vertices.mean(0))
        write_rig_asset(run, mesh, sights, slack, finest, rig.lobe)


def _tell_disagreement(run: StageRun, sight: Sight, mesh: Mesh, solid: RayMesh) -> None:
    maps = sight.maps
    images = disagreement(maps, mesh, solid)
    write_disagreement(run.output / files.DISAGREEMENT / f"{maps.name}.exr", images, maps)
    for name, image in images.items():
        if (image > 0).any():
            run.note(f"{maps.name}.disagreement_{name}", round(float(np.median(image[image > 0])), 4))


def find_surface(run: StageRun, rig: Rig) -> tuple[Mesh, float]:
    """The closed surface before its fine relief, and its voxel's edge (world units). Raises UserError."""
    p = run.parameters
    views = rig.views(p.max_voxels)
    if empty := [v.name for v in views if not v.known.any()]:
        raise UserError(run.inputs["olat"], f"no pixel of {', '.join(empty)} has a normal", "look at its preview.png")
    hull = hull_of(silhouettes_of(views), HULL)
    low, high = hull.box()
    foot = footprint([view.camera for view in views], 0.5 * (low + high))
    voxel = max(p.voxel_px * foot, float((high - low).max()) / p.max_voxels)
    spans = [chords(view, hull) for view in views]
    run.progress.say("mesh: looking for the surface on which the cameras' normals agree")
    known = None
    for _ in range(2):  # the second time every camera sets out from what all of them made
        distances = find_depths(views, spans, known)
        distances = believed(views, distances, supports(views, distances), spans, SLACK * foot)
        field, corner = fused_volume(views, distances, hull, voxel, TRUNCATION * voxel, p.grazing)
        mesh = largest_pieces(without_slivers(extracted(field, corner, voxel)), p.component_pct / 100)
        if not len(mesh.faces):
            raise UserError(run.inputs["olat"], "the cameras' maps share no surface", "check the masks and the cameras")
        solid = RayMesh(mesh.vertices, mesh.faces)
        known = [solid.distance(view.camera.centre, view.camera.rays()).astype(np.float64) for view in views]
    return in_fixed_order(mesh), voxel


def footprint(cameras: Sequence[Camera], centre: NDArray) -> float:
    """A pixel's usual width at the object (world units)."""
    return float(np.median([np.linalg.norm(c.centre - centre) / np.sqrt(c.fx * c.fy) for c in cameras]))


def with_maps(mesh: Mesh, sights: Sights, slack: float) -> Mesh:
    """The mesh with all cameras' maps fused on its vertices; what is seen over `slack` (world units) off is another one."""
    points = SurfacePoints(mesh.vertices, mesh.normals())
    found = fused_maps((camera_values(sight, points, slack) for sight in sights), points.normal)
    return Mesh(mesh.vertices, mesh.faces, filled(points.position, found, points.normal))


def vertex_table(mesh: Mesh) -> dict[str, NDArray]:
    """Vertex properties by name [V]: position, normal, material, its standard deviations, and display colour in bytes."""
    a = mesh.attributes
    large, small = a["sigma"].T
    total = np.maximum(large + small, 1e-9)
    columns = {
        **dict(zip("xyz", mesh.vertices.T)), **dict(zip(("nx", "ny", "nz"), a["normal"].T)),
        **dict(zip(("albedo_r", "albedo_g", "albedo_b"), a["albedo"].T)), "roughness": (large * small) ** 0.25,
        "specular": a["specular"], "sigma_x": large, "sigma_y": small, "anisotropy": (large - small) / total,
        **dict(zip(("tangent_x", "tangent_y", "tangent_z"), a["tangent"].T)), "occlusion": a["occlusion"],
        "coverage": a["coverage"],
        **{name: a[name] for name in STANDARD_DEVIATIONS},
    }  # fmt: skip
    colour = (srgb_encode(a["albedo"]) * 255 + 0.5).astype(np.uint8)
    numbers = {name: np.asarray(values, np.float32) for name, values in columns.items()}
    return {**numbers, **dict(zip(("red", "green", "blue"), colour.T))}
