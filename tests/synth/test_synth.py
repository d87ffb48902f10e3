"""The synthetic captures: closed object, repeatable rendering, physics as the conventions say."""

from __future__ import annotations

import numpy as np
import pytest

from pipeline.capture import open_capture
from pipeline.formats.images import read_image, read_stokes
from pipeline.geometry.cameras import Camera, camera_from_opengl
from synth.environments import ENVIRONMENTS, directions
from synth.orbit import look_at
from synth.print import AROUND, INK, LABEL, LINES, PAPER, printed
from synth.seen_texture import seen_texture
from synth.shape import bowl, glaze, vase

RGB = ("R", "G", "B")


@pytest.fixture(scope="module")
def captures(tmp_path_factory):
    """A very small pair of captures: 2 views of 32x32, 6 lights."""
    pytest.importorskip("mitsuba")
    from synth import stage_capture, view_capture

    root = tmp_path_factory.mktemp("synth")
    view_capture.make(root / "views", size=32, views=2, spp=16, seed=3)
    stage_capture.make(root / "stage", size=32, lights=6, spp=16, seed=3)
    return root


@pytest.mark.parametrize(("make", "least"), [(vase, 1.0), (bowl, 0.3)])
def test_object_is_closed_outward_and_smooth(make, least):
    shape = make(48, 40)
    corner = shape.vertices[shape.faces]
    volume = np.einsum("ij,ij->i", corner[:, 0], np.cross(corner[:, 1], corner[:, 2])).sum() / 6
    assert volume > least  # 1.9, 0.6
    _, welded = np.unique(shape.vertices.round(9), axis=0, return_inverse=True)
    faces = welded.ravel()[shape.faces]
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    forward, backward = edges[:, 0] * 10**6 + edges[:, 1], edges[:, 1] * 10**6 + edges[:, 0]
    assert np.array_equal(np.sort(forward), np.sort(backward))
    assert np.allclose(np.linalg.norm(shape.normals, axis=1), 1)


@pytest.mark.parametrize("make", [vase, bowl])
def test_object_is_not_convex(make):
    shape = make(48, 40)
    centre = shape.vertices[shape.faces].mean(1)
    normal = shape.normals[shape.faces[:, 0]]
    beyond = ((shape.vertices[None, ::7] - centre[::11, None]) * normal[::11, None]).sum(-1).max(1)
    assert (beyond > 0.05).mean() > 0.2


@pytest.mark.parametrize("name", sorted(ENVIRONMENTS))
def test_environments_are_positive_and_high_range(name):
    sky = ENVIRONMENTS[name](32)
    assert sky.shape == (32, 64, 3)
    assert sky.min() > 0
    assert sky.max() > 2
    assert np.allclose(np.linalg.norm(directions(8), axis=-1), 1)


def test_captures_are_recognised(captures):
    views = open_capture(captures / "views")
    assert (views.kind, views.polarisation, len(views.views)) == ("multiview", "stokes", 2)
    assert len(views.cameras) == 2
    assert isinstance(views.masks, dict)
    stage = open_capture(captures / "stage")
    assert stage.kind == "light_stage"
    assert len(stage.light_stage.lights) == 6


def test_same_seed_gives_the_same_bytes(captures, tmp_path):
    from synth import view_capture

    view_capture.make(tmp_path / "views", size=32, views=2, spp=16, seed=3)
    for name in ("images/000.exr", "masks/001.png", "gt/normal/001.exr", "gt/relight/studio/000.exr"):
        assert (tmp_path / "views" / name).read_bytes() == (captures / "views" / name).read_bytes()


def test_views_are_physical_and_black_outside(captures):
    stokes = read_stokes(captures / "views" / "images" / "000.exr").astype(float)
    mask = read_image(captures / "views" / "masks" / "000.png")[..., 0]
    assert np.abs(stokes[mask == 0]).max() == 0
    s0, polarised = stokes[:, :, 0].mean(-1), np.hypot(stokes[:, :, 1].mean(-1), stokes[:, :, 2].mean(-1))
    assert (polarised[mask > 0.99] <= s0[mask > 0.99]).all()
    assert polarised[mask > 0.99].max() > 0.01


def test_stage_frames_follow_the_lambert_law(captures):
    """Irradiance pi per light: where nothing shadows, cross = albedo (n.l) / 2."""
    stage = open_capture(captures / "stage")
    truth = np.load(captures / "stage" / "cam00" / "gt" / "maps.npz")
    inside = truth["mask"] > 0.99
    for k, light in enumerate(stage.light_stage.lights.directions):
        cross = read_image(captures / "stage" / "cam00" / "cross" / f"{k:06d}.exr", RGB)[inside]
        expected = 0.5 * truth["albedo"][inside] * np.maximum(truth["normal"][inside] @ light, 0)[:, None]
        lit = expected.mean(-1) > 0.1
        if lit.sum() > 20:
            ratio = cross[lit].mean(-1) / expected[lit].mean(-1)
            assert np.median(ratio) == pytest.approx(1.0, abs=0.05)  # inter-reflection adds a few percent
            return
    pytest.fail("no light is in front of the object")


@pytest.mark.slow
def test_anisotropic_stages_are_light_stages_with_noise_and_clipping(tmp_path):
    pytest.importorskip("mitsuba")
    from synth import anisotropic

    anisotropic.build(tmp_path / "rubble", "rubble", [], size=24, lights=6, seed=0)
    capture = open_capture(tmp_path / "rubble")
    camera = capture.light_stage.cameras["cam00"]
    frames = np.stack([read_image(path, RGB) for path in camera.parallel])
    assert len(frames) == 6
    assert frames.max() <= anisotropic.CLIP and frames.min() < 0  # half of the noise about black is below it


def test_a_camera_sees_the_mean_of_a_texture_over_each_pixel():
    square = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0.0]])
    faces, uv = np.array([[0, 1, 2], [0, 2, 3]]), np.array([[0, 1], [1, 1], [1, 0], [0, 0.0]])  # the first row is on top
    image = np.zeros((8, 8, 2), np.float32)
    image[..., 0] = (np.arange(8) + 0.5) / 8  # to the right
    image[:4, :, 1] = 1
    camera = Camera(12, 12, 16.0, 16.0, 6.0, 6.0, camera_from_opengl(look_at(np.array([0, 0, 4.0]))))
    seen, covered = seen_texture(square, faces, uv, image, camera)
    across = (np.arange(8) + 0.5) / 8
    assert covered[2:10, 2:10].min() == 1 and covered[:2].max() == 0  # 16 px a unit at 4: the square is 8 px wide
    assert np.allclose(seen[2:10, 3:9, 0], across[1:7], atol=1e-3)
    assert np.allclose(seen[2:5, 2:10, 1], 1, atol=1e-3) and np.allclose(seen[7:10, 2:10, 1], 0, atol=1e-3)


def test_the_printed_label_is_ink_on_paper_that_reads_upright():
    height = 512
    albedo = printed(height)
    first, last = (round(share * height) for share in LABEL)
    label = albedo[first:last][::-1, : 2 * height // AROUND]  # from the top down
    ink = np.isclose(label, INK, atol=1e-3).all(-1)
    assert np.isclose(label, PAPER, atol=1e-3).all(-1).mean() > 0.6 and 0.03 < ink.mean() < 0.3
    edges = np.flatnonzero(np.diff(ink.any(1).astype(int)))
    lines = edges[1::2] - edges[::2]  # rows of each
    assert len(lines) == len(LINES) and lines[0] > 1.5 * lines[-1]  # the largest is on top
    assert np.array_equal(albedo[last:], glaze(height)[last:])
