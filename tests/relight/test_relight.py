"""Relighting: any up axis, black outside the object, maps that are not maps, turntables of the written mesh."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace

import numpy as np
import pytest

from pipeline.capture import Capture
from pipeline.engine.progress import Progress
from pipeline.engine.stage import StageRun
from pipeline.errors import UserError
from pipeline.formats.backdrop import grown
from pipeline.formats.images import read_exr, read_image, read_stokes, write_exr, write_mask, write_rgb
from pipeline.geometry.cameras import Camera, camera_from_opengl, save_cameras
from pipeline.geometry.rays import RayMesh
from pipeline.geometry.world import Y_UP_FROM
from stages.relight.environment_map import read_map
from stages.relight.mesh_images import BakedMesh
from stages.relight.outlines import Inner, blended, find_outlines, interior, silhouette, without_bright_rims
from stages.relight.parameters import RelightParameters
from stages.relight.stage import needed
from stages.relight.stage import run as run_stage
from synth.environments import meadow
from synth.orbit import look_at, orbit
from synth.shape import vase

SIZE = 40


def gbuffer(camera: Camera, mesh) -> dict[str, np.ndarray]:
    """The vase as a G-buffer, by ray casting."""
    vertices, faces, normals = mesh
    rays = camera.rays().reshape(-1, 3)
    found = RayMesh(vertices, faces).cast(camera.centre, rays)
    t, hit = found.distance, found.hit
    n = np.zeros((len(rays), 3))
    n[hit] = np.einsum("nk,nkc->nc", found.weights[hit], normals[faces[found.triangle[hit]]])
    n[hit] /= np.linalg.norm(n[hit], axis=1, keepdims=True)
    depth = np.where(hit, t, 0) * (rays @ camera.world_to_camera[2, :3])
    flat = {f"N.{c}": n[:, k] for k, c in enumerate("XYZ")}
    flat |= {f"albedo.{c}": hit * a for c, a in zip("RGB", (0.7, 0.3, 0.1))}
    flat |= {"roughness": hit * 0.4, "ior": hit * 1.5, "alpha": hit * 1.0, "depth": depth}
    return {k: a.reshape(SIZE, SIZE).astype(np.float32) for k, a in flat.items()}


@pytest.fixture
def relit(tmp_path):
    """Function that lays out a dataset of two views, with a given up axis, and relights it."""

    def go(up: str = "y", occlusion: bool = False, with_mask: bool = False, learnt: bool = True, **parameters):
        root = tmp_path / f"{up}{occlusion}{with_mask}{parameters.get('indirect')}"
        turn = Y_UP_FROM[up]  # y-up frame from this world
        shape = vase(48, 36)
        mesh = (shape.vertices @ turn, shape.faces, shape.normals @ turn)
        cameras = {}
        for k, position in enumerate(orbit(2, 5.0, 10, 40)):
            pose = np.eye(4)
            pose[:3, :3], pose[:3, 3] = turn.T @ look_at(position)[:3, :3], turn.T @ position
            cameras[f"v{k}"] = Camera(SIZE, SIZE, 80.0, 80.0, SIZE / 2, SIZE / 2, camera_from_opengl(pose))
        train, poses, masks, out = (root / n for n in ("train", "poses", "masks", "out"))
        for folder in (train, poses, masks, out):
            folder.mkdir(parents=True)
        save_cameras(poses / "cameras.json", cameras)
        for name, camera in cameras.items():
            write_exr(train / "gbuffer" / f"{name}.exr", gbuffer(camera, mesh))
            if learnt:
                write_exr(train / "indirect" / f"{name}.exr", dict.fromkeys("RGB", np.full((SIZE, SIZE), 3, np.float32)))
        facts = {"schema": 1, "up": up, "fresnel": "exact", "lobe": "ggx", "occlusion": occlusion}
        (train / "lighting.json").write_text(json.dumps(facts))
        write_rgb(root / "sky.hdr", meadow(32))
        inputs = {"train": train, "poses": poses}
        if with_mask:
            half = np.zeros((SIZE, SIZE), bool)
            half[:, : SIZE // 2] = True
            for name in cameras:
                write_mask(masks / f"{name}.png", half)
            inputs["masks"] = masks
        if occlusion or parameters.get("turntable"):
            _write_mesh(root / "mesh", mesh)
            inputs["mesh"] = root / "mesh"
        capture = Capture(root, "made up", "multiview", "stokes", up=up)
        run = StageRun(
            capture, RelightParameters(cube=32, **parameters), inputs, out, root, environments=(root / "sky.hdr",),
            progress=Progress(quiet=True),
        )  # fmt: skip
        run_stage(run)
        return run

    return go


def _write_mesh(folder, mesh) -> None:
    from pipeline.formats.ply import write_ply
    from pipeline.geometry.mesh import Mesh
    from stages.mesh.attributes import vertex_table

    material = np.tile(np.array([0.7, 0.3, 0.1, 0.4, 1.5], np.float32), (len(mesh[0]), 1))
    whole = Mesh(mesh[0], mesh[1], {"normal": mesh[2].astype(np.float32), "material": material})
    folder.mkdir()
    write_ply(folder / "mesh.ply", vertex_table(whole), mesh[1])


def test_every_view_is_lit_and_black_outside_the_object(relit):
    run = relit()
    for name in ("v0", "v1"):
        stokes = read_stokes(run.output / "sky" / f"{name}.exr")
        alpha = read_image(run.inputs["train"] / "gbuffer" / f"{name}.exr", ("alpha",))[..., 0]
        assert (stokes[alpha == 0] == 0).all()
        assert (stokes[alpha == 1][:, 0] > 0).all()
        assert np.isfinite(stokes).all()
        assert (run.output / "sky" / f"{name}.png").exists()
    assert run.facts["indirect"]["run"] is False


@pytest.mark.slow
@pytest.mark.parametrize("up", ["z", "-y", "x"])
def test_up_axis_turns_the_map_with_the_capture(relit, up):
    a = read_stokes(relit("y").output / "sky" / "v1.exr")
    b = read_stokes(relit(up).output / "sky" / "v1.exr")
    assert a[:, :, 0].max() > 0.1
    assert np.abs(a - b).max() < 0.02 * a.max()
    assert np.abs(a - b).mean() < 1e-4


def test_nothing_is_drawn_outside_the_mask(relit):
    stokes = read_stokes(relit(with_mask=True).output / "sky" / "v0.exr")
    assert (stokes[:, SIZE // 2 + 1 :] == 0).all()
    assert stokes[:, : SIZE // 2, 0].max() > 0


@pytest.mark.slow
def test_self_occlusion_darkens_the_bowl_and_brightens_nothing_by_much(relit):
    free = read_stokes(relit(occlusion=True, indirect="none").output / "sky" / "v1.exr")[:, :, 0]
    run = relit(occlusion=True)
    shadowed = read_stokes(run.output / "sky" / "v1.exr")[:, :, 0]
    assert run.facts["indirect"]["run"] is True
    assert np.minimum(shadowed, free).sum() < 0.985 * free.sum()  # 0.980 measured
    assert shadowed.sum() < 0.995 * free.sum()  # 0.990: bounces give back half of what is shadowed
    assert (shadowed < 0.7 * free).any()
    assert (shadowed <= 1.3 * free + 0.02).all()


@pytest.mark.slow
def test_every_kind_of_indirect_light_can_be_asked_for(relit):
    images = {}
    for kind in ("none", "gridmap", "sh", "traced"):
        run = relit(occlusion=True, indirect=kind)
        assert run.facts["indirect"]["run"] == (kind != "none")
        images[kind] = read_stokes(run.output / "sky" / "v1.exr")[:, :, 0].sum(-1)
    shown = images["none"] > 0
    there = {kind: (image != images["none"])[shown].mean() for kind, image in images.items()}
    assert there["gridmap"] == 1 and there["traced"] > 0.3  # GridMap replaces all diffuse light
    assert 0 < there["sh"] < 0.3  # and harmonics only what the mirror ray does not reach: 0.06
    assert 0.6 < images["gridmap"].sum() / images["none"].sum() < 1.4  # 0.91


@pytest.mark.slow
def test_indirect_light_is_as_in_training_unless_it_is_named(relit):
    assert relit(occlusion=True).facts["indirect"]["reason"].startswith("traced")
    assert relit().facts["indirect"]["reason"] == "training saw no self-occlusion"


def test_harmonics_that_training_has_not_learnt_are_refused(relit):
    with pytest.raises(UserError, match=r"train\.indirect=sh"):
        relit(occlusion=True, indirect="sh", learnt=False)


@pytest.mark.slow
@pytest.mark.parametrize("occlusion", [False, True])
def test_turntable_and_camera_path_show_the_mesh(relit, occlusion):
    run = relit(occlusion=occlusion, turntable=3, turntable_size=48, cameras="poses/cameras.json")
    frames = [read_image(run.output / "sky" / "turntable" / f"{k:03d}.png") for k in range(3)]
    shown = [(f.max(-1) > 0).mean() for f in frames]
    assert 0.08 < min(shown) <= max(shown) < 0.8
    assert np.abs(frames[0] - frames[1]).max() > 0.1
    assert (run.output / "sky" / "turntable.webp").stat().st_size > 100
    assert run.facts["turntable"]["mp4"] == (run.output / "sky" / "turntable.mp4").is_file() == bool(shutil.which("ffmpeg"))
    for k, view in enumerate(("v0", "v1")):  # the capture's own cameras: nearly the views themselves
        seen = read_stokes(run.output / "sky" / "path" / f"{k:03d}.exr")
        view_image = read_stokes(run.output / "sky" / f"{view}.exr")
        assert np.abs(seen - view_image).mean() < 0.05 * view_image[:, :, 0].mean()
    assert (run.output / "sky" / "path.webp").stat().st_size > 100


def test_map_of_another_projection_is_refused(tmp_path):
    write_rgb(tmp_path / "square.hdr", np.ones((8, 8, 3)))
    with pytest.raises(UserError, match="twice as wide as high"):
        read_map(tmp_path / "square.hdr")


def test_bad_texels_are_black_and_reported(tmp_path):
    sky = meadow(8)
    sky[0, 0] = np.nan
    sky[1, 1] = -1
    write_rgb(tmp_path / "sky.exr", sky)
    radiance, faults = read_map(tmp_path / "sky.exr")
    assert np.isfinite(radiance).all() and radiance.min() == 0
    assert ["not finite" in faults[0], "negative" in faults[1]] == [True, True]


def test_needed_only_where_there_are_maps_and_a_model(tmp_path):
    views = tuple(object() for _ in range(9))
    capture = Capture(tmp_path, "made up", "multiview", "stokes", views=views)
    assert not needed(capture, RelightParameters()).run
    assert needed(replace(capture, environments=(tmp_path / "a.hdr",)), RelightParameters()).run
    assert not needed(replace(capture, views=views[:3], environments=(tmp_path / "a.hdr",)), RelightParameters()).run


@pytest.mark.slow
def test_outlines_show_the_surfaces_of_the_mesh_and_not_the_blend_of_the_gbuffer(relit):
    whole = relit(occlusion=True)
    path = whole.inputs["train"] / "gbuffer" / "v1.exr"
    right = read_stokes(whole.output / "sky" / "v1.exr")[:, :, 0]
    channels = read_exr(path)
    alpha = channels["alpha"]
    rim = (alpha > 0) & ~interior(alpha > 0)
    steady = ~rim & ~blended(np.stack([channels[f"N.{c}"] for c in "XYZ"], -1))
    for k, name in enumerate(("N.X", "N.Y", "N.Z")):  # as where the sun meets the blend of a front and a back
        channels[name][rim] = (0.6, 0.62, 0.5)[k] / np.linalg.norm((0.6, 0.62, 0.5))
    channels["alpha"][rim] = 0.5
    write_exr(path, channels)
    run_stage(whole)
    got = read_stokes(whole.output / "sky" / "v1.exr")[:, :, 0]
    met = rim & (got.max(-1) > 0)
    assert met.sum() > 0.9 * rim.sum()
    assert np.abs(2 * got - right)[met].mean() < 0.25 * right[met].mean()
    steady &= ~blended(np.stack([channels[f"N.{c}"] for c in "XYZ"], -1))
    assert np.abs(got - right)[steady].max() < 1e-5


def test_silhouettes_are_part_empty_at_the_masks_edge_and_blends_lie_between_normals_that_differ():
    normal = np.tile([0.0, 0, 1], (5, 7, 1))
    normal[:, 4:] = [0.9, 0, 0.43589]
    alpha, whole = np.ones((5, 7)), np.zeros((5, 7), bool)
    whole[1:-1, 1:-1] = True
    alpha[0, 0] = alpha[2, 2] = 0.5
    normal[2, 1] = 0  # nothing there: its neighbours are no blend for its sake
    want = np.zeros((5, 7), bool)
    want[0, 0] = True
    assert (silhouette(alpha, whole) == want).all()
    want[:], want[:, 3:5] = False, True
    assert (blended(normal) == want).all()


def test_a_rim_is_no_brighter_than_what_it_lies_between_and_keeps_its_polarisation():
    stokes = np.ones((5, 5, 3, 3), np.float32)
    stokes[:, :, 1:] = 0.1
    rim = np.zeros((5, 5), bool)
    rim[:, 2] = True
    stokes[1, 2] *= 50  # a dash
    stokes[3, 2] *= 0.1  # a dark gap stays
    got = without_bright_rims(stokes, rim, np.ones((5, 5), bool))
    assert got[1, 2, 0] == pytest.approx(1) and got[1, 2, 1] == pytest.approx(0.1)
    assert (got[3, 2] == stokes[3, 2]).all() and (got[~rim] == stokes[~rim]).all()
    alone = without_bright_rims(stokes, np.ones((5, 5), bool), np.ones((5, 5), bool))
    assert (alone == stokes).all()


def _vase_in_view(tmp_path) -> tuple[BakedMesh, Camera]:
    shape = vase(48, 36)
    _write_mesh(tmp_path / "mesh", (shape.vertices, shape.faces, shape.normals))
    pose = camera_from_opengl(look_at(np.array([0, 1, 5.0])))
    return BakedMesh(tmp_path / "mesh/mesh.ply"), Camera(SIZE, SIZE, 80.0, 80.0, SIZE / 2, SIZE / 2, pose)


def test_a_pixel_beside_the_meshs_silhouette_shows_the_silhouette(tmp_path):
    mesh, camera = _vase_in_view(tmp_path)
    hit = mesh.seen_at(camera, np.arange(SIZE * SIZE), 3).hit.reshape(SIZE, SIZE, 9)
    beside = grown(hit.any(-1)) & ~hit.any(-1)
    index = np.flatnonzero(beside | hit.any(-1))
    found = find_outlines(mesh, camera, index, beside)
    assert (np.sort(index[found.rows]) == np.flatnonzero(beside)).all() and found.met.all() and (found.coverage == 0).all()
    surface = found.surface
    assert np.median((surface.normal * surface.view).sum(1)) < 0.35  # it turns away there
    means = found.replaced(np.zeros((len(index), 3, 3), np.float32), np.ones((len(surface.normal), 3, 3), np.float32))
    assert (means.reshape(-1, 9).max(1) == 1).sum() == beside.sum()


def test_the_mesh_stands_for_blends_within_the_object_where_it_lies_at_the_same_distance(tmp_path):
    mesh, camera = _vase_in_view(tmp_path)
    seen = mesh.seen_at(camera, np.arange(SIZE * SIZE), 3)
    whole = interior(seen.hit.reshape(SIZE, SIZE, 9).all(-1))
    whole = interior(whole)
    distance = np.full((SIZE, SIZE, 9), np.nan)
    distance.reshape(-1)[seen.hit] = np.linalg.norm(seen.surface.position - camera.centre, axis=1)
    wanted = np.zeros_like(whole)
    wanted.flat[np.flatnonzero(whole)[::7]] = True
    steady = np.where(wanted | ~seen.hit.reshape(SIZE, SIZE, 9).all(-1), np.nan, distance.mean(-1))
    index = np.flatnonzero(whole)
    for off, share in ((0.0, 0.8), (0.5, 0.0)):  # a surface that the mesh has, and one half a unit behind it
        inner = Inner(wanted, steady + off, 1 / 80)
        found = find_outlines(mesh, camera, index, np.zeros_like(whole), inner)
        assert len(found.rows) == wanted.sum() and share <= found.met.mean() <= max(share, 1.0 if share else 0.0)
