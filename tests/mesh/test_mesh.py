"""Fusion and cleaning: where the surface lies, at any scale, the same every time."""

from __future__ import annotations

import json
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from pipeline.asset.asset import FORMATS
from pipeline.capture import Capture
from pipeline.engine.progress import Progress
from pipeline.engine.stage import StageRun
from pipeline.errors import UserError
from pipeline.formats.images import read_image, write_exr
from pipeline.formats.ply import write_ply
from pipeline.geometry.cameras import save_cameras
from pipeline.geometry.mesh import Mesh, in_fixed_order, largest_pieces, without_slivers
from stages.mesh.attributes import bake, vertex_table
from stages.mesh.clean import boundary_loops, fill_holes
from stages.mesh.fusion import Volume, measure
from stages.mesh.outline import outline_gap, outline_length
from stages.mesh.parameters import MeshParameters
from stages.relight.mesh_images import read_baked_mesh


def fuse(views) -> Mesh:
    extent = measure(views)
    voxel = 1.2 * extent.footprint
    volume = Volume(views, extent, voxel, 5 * voxel)
    for view in views:
        volume.integrate(view, 0.15)
    return in_fixed_order(largest_pieces(without_slivers(Mesh.from_open3d(volume.extract())), 0.02))


def grid(n: int = 8) -> Mesh:
    """A flat n x n square of triangles: one open boundary."""
    x, y = np.meshgrid(np.arange(n + 1.0), np.arange(n + 1.0))
    index = np.arange((n + 1) ** 2).reshape(n + 1, n + 1)
    a, b, c, d = (part.ravel() for part in (index[:-1, :-1], index[:-1, 1:], index[1:, :-1], index[1:, 1:]))
    faces = np.concatenate([np.stack([a, b, d], -1), np.stack([a, d, c], -1)])
    return Mesh(np.stack([x.ravel(), y.ravel(), 0 * x.ravel()], -1), faces)


@pytest.mark.parametrize("radius", [1e-3, 1.0, 1e4])
def test_sphere_is_recovered_at_any_scale(sphere_views, radius):
    views = sphere_views(radius)
    mesh = fuse(views)
    error = np.abs(np.linalg.norm(mesh.vertices, axis=1) / radius - 1)
    pixel = measure(views).footprint / radius
    assert np.median(error) < 0.15 * pixel  # 0.11 measured
    assert error.max() < 1.5 * pixel
    assert mesh.normals()[0] @ mesh.vertices[0] > 0  # outward


def test_sphere_is_closed_and_whole(sphere_views):
    mesh = fuse(sphere_views(1.0, count=24))
    assert not boundary_loops(mesh)
    area = mesh.area().sum()
    assert area == pytest.approx(4 * np.pi, rel=0.02)


def test_rays_that_miss_carve_floaters_away(sphere_views):
    views = sphere_views(1.0)
    clean = fuse(views)
    dirty = views[0].depth.copy()
    dirty[2:6, 2:6] = 4.5  # a blob beside the object, in one view only
    facing = views[0].normal.copy()
    facing[2:6, 2:6] = -views[0].camera.rays()[2:6, 2:6]
    wrong = [type(views[0])(views[0].camera, dirty, facing, views[0].material, views[0].alpha), *views[1:]]
    assert np.abs(fuse(wrong).vertices).max() == pytest.approx(np.abs(clean.vertices).max(), rel=0.05)


def test_fusion_is_repeatable_to_the_bit(sphere_views):
    a, b = (fuse(sphere_views(1.0)) for _ in range(2))
    assert np.array_equal(a.vertices, b.vertices)
    assert np.array_equal(a.faces, b.faces)


def test_material_is_baked_from_the_views(sphere_views):
    views = sphere_views(1.0)
    mesh, seen = bake(fuse(views), views, 0.1)
    assert seen > 0.99
    assert np.allclose(mesh.attributes["material"], [0.6, 0.3, 0.1, 0.4, 1.5], atol=1e-5)
    radial = mesh.vertices / np.linalg.norm(mesh.vertices, axis=1, keepdims=True)
    assert np.degrees(np.arccos(np.clip((radial * mesh.attributes["normal"]).sum(1), -1, 1))).mean() < 1.5


def test_unseen_vertices_take_the_nearest_material(sphere_views):
    views = sphere_views(1.0)[:1]
    mesh, seen = bake(fuse(sphere_views(1.0)), views, 0.1)
    assert 0.2 < seen < 0.7
    assert np.allclose(mesh.attributes["material"], [0.6, 0.3, 0.1, 0.4, 1.5], atol=1e-5)


def test_holes_are_closed_outward():
    mesh = grid()
    closed, count = fill_holes(mesh)
    assert count == 1
    assert not boundary_loops(closed)
    lid = Mesh(closed.vertices, closed.faces[len(mesh.faces) :])
    a, b, c = (lid.vertices[lid.faces[:, k]] for k in range(3))
    assert (np.cross(b - a, c - a)[:, 2] < 1e-9).all()  # the square looks up, its lid down


def test_small_pieces_go_and_large_ones_stay():
    big, small = grid(8), grid(1)
    far = Mesh(small.vertices + 100, small.faces)
    both = Mesh(np.concatenate([big.vertices, far.vertices]), np.concatenate([big.faces, far.faces + len(big.vertices)]))
    assert len(largest_pieces(both, 0.1).faces) == len(big.faces)
    assert len(largest_pieces(both, 0.001).faces) == len(both.faces)


def test_order_does_not_depend_on_the_input_order():
    mesh = grid(4)
    shuffle = np.random.default_rng(0).permutation(len(mesh.vertices))
    place = np.argsort(shuffle)
    other = Mesh(mesh.vertices[shuffle], np.roll(place[mesh.faces], 1, axis=1)[::-1])
    a, b = in_fixed_order(mesh), in_fixed_order(other)
    assert np.array_equal(a.vertices, b.vertices)
    assert np.array_equal(a.faces, b.faces)


def test_ply_is_read_by_open3d_with_its_colours(sphere_views, tmp_path):
    import open3d as o3d

    views = sphere_views(1.0, count=8, size=40)
    mesh, _ = bake(fuse(views), views, 0.2)
    write_ply(tmp_path / "mesh.ply", vertex_table(mesh), mesh.faces)
    back = o3d.io.read_triangle_mesh(str(tmp_path / "mesh.ply"))
    assert len(back.triangles) == len(mesh.faces)
    assert np.allclose(np.asarray(back.vertices), mesh.vertices, atol=1e-6)
    assert back.has_vertex_colors()
    assert back.has_vertex_normals()


@pytest.fixture
def run_stage(sphere_views, tmp_path):
    """Function that runs the whole stage on views."""

    def go(views, **parameters):
        from stages.mesh.run import make_mesh

        train, poses, out = tmp_path / "train", tmp_path / "poses", tmp_path / "out"
        for folder in (poses, out):
            folder.mkdir()
        save_cameras(poses / "cameras.json", {f"v{k}": v.camera for k, v in enumerate(views)})
        for k, v in enumerate(views):
            channels = {f"N.{c}": v.normal[..., i] for i, c in enumerate("XYZ")}
            channels |= {f"albedo.{c}": v.material[..., i] for i, c in enumerate("RGB")}
            channels |= {"roughness": v.material[..., 3], "ior": v.material[..., 4], "alpha": v.alpha, "depth": v.depth}
            write_exr(train / "gbuffer" / f"v{k}.exr", channels)
        capture = SimpleNamespace(up="y", polarisation="none", config=SimpleNamespace(unit_m=None))
        inputs, p = {"train": train, "poses": poses}, MeshParameters(**{"textures": False} | parameters)
        run = StageRun(cast(Capture, capture), p, inputs, out, tmp_path, progress=Progress(quiet=True))
        make_mesh(run)
        return run

    return go


@pytest.mark.slow
def test_stage_writes_tsdf_and_poisson_meshes(sphere_views, run_stage):
    run = run_stage(sphere_views(1.0), poisson=True, poisson_depth=5)
    assert (run.output / "mesh.ply").exists()
    _, _, faces = read_baked_mesh(run.output / "mesh_poisson.ply")
    edges = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    assert (np.unique(edges, axis=0, return_counts=True)[1] == 2).all()  # closed
    assert run.facts["size"] == pytest.approx(2.0, rel=0.03)


@pytest.mark.slow
def test_stage_writes_an_asset_that_tells_where_it_was_baked_from(sphere_views, run_stage):
    run = run_stage(sphere_views(1.0, count=8, size=32), textures=True, max_texture=128)
    folder = run.output / "asset"
    table = json.loads((folder / "asset.json").read_text())
    assert max(table["texture_size"]) <= 128
    assert table["detail"] == "model"  # no photographs were given
    assert table["unit_m"] is None
    albedo = read_image(folder / "textures" / "albedo.exr", ("R", "G", "B"))
    assert np.allclose(albedo.reshape(-1, 3), [0.6, 0.3, 0.1], atol=2e-3)
    assert all((folder / name).exists() for names in FORMATS.values() for name in names)


@pytest.mark.slow
def test_outlines_pull_a_shrunken_surface_back(sphere_views):
    views = sphere_views(1.0, size=96)
    shrunk = [type(v)(v.camera, np.where(v.depth > 0, v.depth + 0.03, 0).astype(np.float32), *vars_of(v)) for v in views]
    extent = measure(shrunk)
    volume = Volume(shrunk, extent, 1.2 * extent.footprint, 7 * extent.footprint)
    for view in shrunk:
        volume.integrate(view, 0.15)
    before = Mesh.from_open3d(volume.extract())
    gap = outline_gap(before, shrunk)
    after = Mesh.from_open3d(volume.extract(gap))
    radius = [np.median(np.linalg.norm(m.vertices, axis=1)) for m in (before, after)]
    assert radius[0] < 0.985
    assert abs(radius[1] - 1) < 0.4 * abs(radius[0] - 1)


def vars_of(view):
    return view.normal, view.material, view.alpha


@pytest.mark.slow
def test_discs_that_do_not_quite_cover_and_a_lid_that_stands_out_move_no_outline(sphere_views):
    views = sphere_views(1.0, size=96)
    mesh = fuse(views)
    pixel = measure(views).footprint
    whole = outline_gap(mesh, views)
    thin = [type(v)(v.camera, v.depth, v.normal, v.material, (0.9 * v.alpha).astype(np.float32)) for v in views]
    assert outline_gap(mesh, thin) == pytest.approx(whole, abs=0.05 * pixel)  # by area it would be 1.2 px
    far = mesh.vertices[:, 1] < -0.8 * np.abs(mesh.vertices[:, 1]).max()
    bulge = Mesh(np.where(far[:, None], mesh.vertices * 1.15, mesh.vertices), mesh.faces)
    assert outline_gap(bulge, views) == pytest.approx(whole, abs=0.1 * pixel)


def test_outline_length_of_a_disc():
    y, x = np.mgrid[:200, :200]
    disc = np.hypot(x - 100, y - 100) < 70
    assert outline_length(disc) == pytest.approx(2 * np.pi * 70, rel=0.02)


def test_empty_depth_is_a_user_error(sphere_views, run_stage):
    views = [type(v)(v.camera, 0 * v.depth, v.normal, v.material, v.alpha) for v in sphere_views(1.0, count=3)]
    with pytest.raises(UserError, match="no view shows the object"):
        run_stage(views)


def test_surfaces_whose_outlines_agree_are_extracted_once(sphere_views, run_stage, monkeypatch):
    from stages.mesh import run as steps

    extracted = []
    whole = Volume.extract
    monkeypatch.setattr(Volume, "extract", lambda self, outward=0.0: extracted.append(outward) or whole(self, outward))
    monkeypatch.setattr(steps, "outline_gap", lambda mesh, views: 0.0)
    run_stage(sphere_views(1.0, count=8, size=32))
    assert extracted == [0.0]


def test_a_volume_extracts_what_was_fused_since(sphere_views):
    views = sphere_views(1.0, count=8, size=32)
    extent = measure(views)
    volume = Volume(views, extent, 1.2 * extent.footprint, 7 * extent.footprint)
    counts = []
    for part in (views[:2], views[2:]):
        for view in part:
            volume.integrate(view, 0.15)
        counts.append(len(Mesh.from_open3d(volume.extract()).faces))
    assert counts[1] > counts[0] > 0
