"""The mesh stage's steps, from G-buffers to mesh.ply."""

from __future__ import annotations

from dataclasses import asdict

import numpy as np

from pipeline.engine.stage import StageRun
from pipeline.errors import UserError
from pipeline.formats import dataset_files as files
from pipeline.formats.ply import write_ply
from pipeline.geometry.cameras import load_cameras, world_offset
from pipeline.geometry.mesh import Mesh, in_fixed_order, keep_faces, largest_pieces, without_slivers
from pipeline.geometry.topology import topology
from pipeline.geometry.world_offset import ply_comment

from .attributes import bake, vertex_table
from .clean import fill_holes, unfolded
from .decimate import decimated
from .fusion import Extent, Volume, measure
from .gbuffer import Views
from .outline import outline_gap
from .refine import following_normals
from .textures import write_textured

ROUNDS = 2  # of matching outlines: the second corrects the first by a few percent of it
OUTLINE_ERROR = 0.02  # px: areas tell an outline's place no better (outline.ENOUGH_RAYS), so smaller gaps move nothing
MOST_OUTWARD = 0.5  # of the truncation, where the field is still a distance


def make_mesh(run: StageRun) -> None:
    """Fuse, extract, clean, bake, write."""
    p = run.parameters
    cameras = run.inputs["poses"] / files.CAMERAS
    views = Views(run.inputs["train"], load_cameras(cameras))
    extent = measure(views)
    voxel = max(p.voxel_px * extent.footprint, extent.size / p.max_voxels)
    mesh, outward = _surface(run, views, extent, voxel)
    holes = 0
    if p.fill_holes:
        mesh, holes = fill_holes(mesh)
    mesh, seen = bake(unfolded(in_fixed_order(without_slivers(mesh))), views, 2 * voxel + abs(outward))
    if p.follow_normals:
        mesh = unfolded(following_normals(mesh, p.follow_normals))
    if p.decimate:
        run.progress.say(f"mesh: {len(mesh.faces)} triangles, as few as {p.decimate:g} px allow are kept")
        mesh = in_fixed_order(unfolded(decimated(mesh, p.decimate * extent.footprint)))
        mesh, seen = bake(mesh, views, 2 * voxel + abs(outward))
    write_ply(run.output / files.MESH, vertex_table(mesh), mesh.faces, comments=ply_comment(world_offset(cameras)))
    run.note("size", extent.size)
    run.note("voxel", voxel)
    run.note("outward", outward)
    run.note("triangles", len(mesh.faces))
    run.note("vertices_seen", seen)
    run.note("holes_filled", holes)
    for name, value in asdict(topology(mesh.vertices, mesh.faces)).items():
        run.note(name, value)
    if p.textures:
        write_textured(run, mesh, views, extent.footprint)
    if p.poisson:
        _write_poisson(run, mesh, views, voxel)


def _surface(run: StageRun, views: Views, extent: Extent, voxel: float) -> tuple[Mesh, float]:
    """The cleaned surface, and how far outward of the fused depths it lies."""
    p = run.parameters
    truncation = p.truncation_voxels * voxel
    volume = Volume(views, extent, voxel, truncation)
    with run.progress.bar("fusing depth", total=len(views), unit="views") as bar:
        for view in views:
            volume.integrate(view, p.grazing)
            bar.advance(1)

    def pieces(outward: float) -> Mesh:
        return largest_pieces(without_slivers(Mesh.from_open3d(volume.extract(outward))), p.component_pct / 100)

    mesh = pieces(0.0)
    outward, limit = 0.0, MOST_OUTWARD * truncation
    for _ in range(ROUNDS if p.match_outlines and len(mesh.faces) else 0):
        gap = outline_gap(mesh, views)
        if abs(gap) < OUTLINE_ERROR * extent.footprint:
            break
        outward = float(np.clip(outward + gap, -limit, limit))
        mesh = pieces(outward)
    if not len(mesh.faces):
        folder = run.inputs["train"] / files.GBUFFERS
        raise UserError(folder, "the depth images hold no surface", "look at the train stage's pictures: did it train?")
    return mesh, outward


def _write_poisson(run: StageRun, mesh: Mesh, views: Views, voxel: float) -> None:
    from .poisson import poisson_surface

    surface = largest_pieces(without_slivers(poisson_surface(mesh, run.parameters.poisson_depth)), 0.02)
    surface = in_fixed_order(keep_faces(surface, surface.area() > 0))
    surface, _ = bake(surface, views, 3 * voxel)
    comments = ply_comment(world_offset(run.inputs["poses"] / files.CAMERAS))
    write_ply(run.output / files.POISSON, vertex_table(surface), surface.faces, comments=comments)
