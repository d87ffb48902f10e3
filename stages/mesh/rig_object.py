"""A light stage's mesh: surface from masks and normals of all cameras, their maps fused on its vertices."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pipeline.asset.ambient import sky_seen
from pipeline.engine.stage import StageRun
from pipeline.formats import dataset_files as files
from pipeline.formats.images import srgb_encode
from pipeline.formats.ply import write_ply
from pipeline.geometry.mesh import Mesh, in_fixed_order
from pipeline.geometry.rays import RayMesh
from pipeline.rig.object_rendering import LOBE
from pipeline.rig.surface.fineness import FINER, MOST_TRIANGLES
from pipeline.rig.surface.read_maps import Rig
from pipeline.rig.surface.search import SurfaceSettings, find_surface, footprint

from .clean import subdivided
from .refine import following_normals
from .rig_surface.atlas_maps import STANDARD_DEVIATIONS, write_rig_asset
from .rig_surface.disagreement import disagreement, write_disagreement
from .rig_surface.sights import Sight, Sights
from .rig_surface.unseen import smoothed_where_unseen
from .rig_surface.vertex_maps import SurfacePoints, camera_values, filled, fused_maps

SEEN_WITHIN = 3.0  # voxels: what a camera sees beyond that is another surface


def make_rig_mesh(run: StageRun) -> None:
    """Find the surface, fuse the maps on it, write mesh.ply, asset/ and how far the cameras disagree. Raises UserError."""
    p = run.parameters
    rig = Rig(run.capture.root, run.inputs["decode"], run.inputs["olat"], run.inputs.get("masks"))
    settings = SurfaceSettings(FINER * p.voxel_px, p.max_voxels, p.grazing, p.component_pct / 100)
    mesh, voxel = find_surface(rig, settings, lambda text: run.progress.say(f"mesh: {text}"))
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
