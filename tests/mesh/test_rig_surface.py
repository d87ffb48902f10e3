"""A light stage's surface: cameras on one side of an object agree on where it is; their maps are fused by what they know."""

from __future__ import annotations

import json
from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
import pytest

from pipeline.asset.anisotropy import in_gltf
from pipeline.capture.config import CaptureConfig
from pipeline.engine.progress import Progress
from pipeline.engine.stage import StageRun
from pipeline.errors import UserError
from pipeline.formats.images import read_image, write_exr, write_png
from pipeline.formats.ply import Ply
from pipeline.geometry.cameras import Camera, camera_from_opengl, frame_of
from pipeline.geometry.mesh import Mesh
from pipeline.rig.object_rendering import RigObject
from pipeline.rig.surface import volume
from pipeline.rig.surface.belief import believed
from pipeline.rig.surface.depths import find_depths, supports
from pipeline.rig.surface.map_view import MapView
from pipeline.rig.surface.volume import chords, hull_of, inscribed_radii, silhouettes_of
from stages.mesh.clean import subdivided
from stages.mesh.parameters import MeshParameters
from stages.mesh.rig_object import make_rig_mesh
from stages.mesh.rig_surface.sights import square_slopes
from stages.mesh.rig_surface.unseen import smoothed_where_unseen
from stages.mesh.rig_surface.vertex_maps import CameraValues, fused_maps
from synth.orbit import look_at

ALBEDO, SPECULAR, SIGMA = (0.6, 0.3, 0.1), 0.4, 0.2
TURNS = np.radians([-60, -25, 10, 45])  # all on one side, as the cameras of a dome are


@dataclass(frozen=True)
class Ball:
    """A camera's exact distances [H, W], normals [H, W, 3] and coverage [H, W] of a ball about the origin."""

    camera: Camera
    distance: np.ndarray
    normal: np.ndarray
    mask: np.ndarray


def ball_views(radius: float, size: int = 40) -> list[Ball]:
    """The ball in every camera; coverage from 4 x 4 rays a pixel."""
    out = []
    for k, turn in enumerate(TURNS):
        centre = 6 * radius * np.array([np.sin(turn), 0.1 * (-1) ** k, np.cos(turn)])
        focal = 0.42 * size * 6
        camera = Camera(size, size, focal, focal, size / 2, size / 2, camera_from_opengl(look_at(centre)))

        def hits(c: Camera) -> tuple[np.ndarray, np.ndarray]:
            along = c.rays() @ c.centre
            inside = along**2 - (c.centre @ c.centre - radius**2)
            return inside > 0, -along - np.sqrt(np.maximum(inside, 0))

        hit, reach = hits(camera)
        fine, _ = hits(camera.resized(4 * size, 4 * size))
        distance = np.where(hit, reach, 0.0)
        normal = np.where(hit[..., None], (camera.centre + camera.rays() * reach[..., None]) / radius, 0.0)
        out.append(Ball(camera, distance, normal, fine.reshape(size, 4, size, 4).mean((1, 3))))
    return out


@pytest.mark.slow
@pytest.mark.parametrize("radius", [1e-3, 1e4])
def test_depths_come_out_of_normals_that_agree(radius):
    """The silhouettes' hull is off by percents; where four normal maps agree is known to a fraction of a pixel (6 % of r)."""
    balls = ball_views(radius)
    views = [MapView(f"cam{k:02d}", b.camera, b.mask, b.normal, 0.5 * (b.normal != 0)) for k, b in enumerate(balls)]
    hull = hull_of(silhouettes_of(views), 64)
    spans = [chords(view, hull) for view in views]
    found = find_depths(views, spans)
    errors, starts = [], []
    for ball, distance, (near, _) in zip(balls, found, spans):
        both = (ball.distance > 0) & (distance > 0) & (near > 0) & (ball.mask > 0.99)
        errors.append(np.abs(distance - ball.distance)[both] / radius)
        starts.append(np.abs(near - ball.distance)[both] / radius)
    error, start = np.concatenate(errors), np.concatenate(starts)
    assert np.median(error) < 0.015 and np.quantile(error, 0.9) < 0.06  # 0.010, 0.04
    assert np.median(start) > 2 * np.median(error)


def test_of_two_distances_that_contradict_the_one_that_others_bear_out_stays():
    """A patch that one camera sets too deep does not take the right one from a camera that sees it there."""
    radius = 1.0
    balls = ball_views(radius)
    views = [MapView(f"cam{k:02d}", b.camera, b.mask, b.normal, 0.5 * (b.normal != 0)) for k, b in enumerate(balls)]
    spans = [chords(view, hull_of(silhouettes_of(views), 64)) for view in views]
    distances = [ball.distance.copy() for ball in balls]
    patch = (slice(15, 25), slice(15, 25))
    distances[1][patch] += 0.4 * radius
    kept = believed(views, distances, supports(views, distances), spans, 0.03 * radius)
    assert not kept[1][17:23, 17:23].any()  # within a pixel of its border the patch is among right neighbours
    for k in (0, 2, 3):
        inner = balls[k].mask > 0.99
        assert np.mean(kept[k][inner] > 0) > 0.97


def test_known_distances_are_kept_and_completed():
    """The search that sets out from a surface stays on it, and pixels that the surface misses follow their neighbours."""
    balls = ball_views(1.0)
    views = [MapView(f"cam{k:02d}", b.camera, b.mask, b.normal, 0.5 * (b.normal != 0)) for k, b in enumerate(balls)]
    spans = [chords(view, hull_of(silhouettes_of(views), 64)) for view in views]
    known = [np.where(ball.distance > 0, ball.distance, np.inf) for ball in balls]
    known[1][15:25, 15:25] = np.inf
    for ball, distance in zip(balls, find_depths(views, spans, known)):
        inner = ball.mask > 0.99
        assert np.quantile(np.abs(distance - ball.distance)[inner & (distance > 0)], 0.95) < 0.02


@pytest.mark.slow
def test_a_volume_in_layers_is_the_volume_at_once(monkeypatch):
    """The grid is gone through a few layers at a time; the ball is the same, and its unseen back no spike."""
    balls = ball_views(1.0)
    views = [MapView(f"cam{k:02d}", b.camera, b.mask, b.normal, 0.5 * (b.normal != 0)) for k, b in enumerate(balls)]
    hull, distances = hull_of(silhouettes_of(views), 64), [ball.distance for ball in balls]
    whole, low = volume.fused_volume(views, distances, hull, 0.05, 0.15, 0.15)
    monkeypatch.setattr(volume, "CHUNK", 5000)
    layered, _ = volume.fused_volume(views, distances, hull, 0.05, 0.15, 0.15)
    np.testing.assert_array_equal(layered, whole)
    places = volume.extracted(whole, low, 0.05).vertices
    away = np.linalg.norm(places, axis=1)
    front = (places[:, 2] > 0.6) & (away > 0.7)  # squarely seen, and not what is guessed of its middle
    assert np.abs(away[front] - 1).max() < 0.05
    assert away.max() < 1.3


def test_the_largest_disc_about_a_pixel():
    mask = np.zeros((40, 60))
    mask[5:35, 5:15] = 1  # a bar ten wide
    mask[10:30, 15:50] = 1  # and one twenty wide
    radii = inscribed_radii(mask)
    assert radii[0, 0] == 0 and 4 <= radii[7, 10] <= 6 and 9 <= radii[20, 40] <= 11


def camera_says(values: list[float], variance: float, seen: bool = True) -> CameraValues:
    """One vertex, one camera: values of normal, albedo, specular albedo, widths and tangent."""
    row = np.array([[*values]], np.float32)
    return CameraValues(row, np.full((1, 4), variance, np.float32), np.full((1, 2), float(seen), np.float32))


def test_maps_are_fused_by_inverse_variance_and_an_outlier_is_dropped():
    def say(level: float) -> list[float]:
        return [0, 0, 1, level, level, level, level, 0.2, 0.2, 0, 0, 0]

    two = fused_maps([camera_says(say(0.4), 1e-4), camera_says(say(0.6), 3e-4)], np.array([[0.0, 0, 1]]))
    assert two["albedo"][0, 0] == pytest.approx(0.45, abs=1e-3)
    many = fused_maps([camera_says(say(v), 1e-4) for v in (0.50, 0.501, 0.499, 0.5, 0.9)], np.array([[0.0, 0, 1]]))
    assert many["albedo"][0, 0] == pytest.approx(0.5, abs=0.03) and many["coverage"][0] == 5
    hidden = fused_maps([camera_says(say(0.4), 1e-4), camera_says(say(0.6), 1e-4, False)], np.array([[0.0, 0, 1]]))
    assert hidden["albedo"][0, 0] == pytest.approx(0.4, abs=1e-6) and hidden["coverage"][0] == 1


def test_the_fused_standard_deviation_is_that_of_the_mean():
    rng = np.random.default_rng(0)
    count, noise = 4000, 0.01
    cameras = []
    for _ in range(4):
        values = np.zeros((count, 12), np.float32)
        values[:, 2], values[:, 7:9] = 1, SIGMA
        values[:, 3:6] = 0.5 + noise * rng.normal(size=(count, 3))
        values[:, 6] = 0.4
        cameras.append(CameraValues(values, np.full((count, 4), noise**2, np.float32), np.ones((count, 2), np.float32)))
    fused = fused_maps(cameras, np.tile([0.0, 0, 1], (count, 1)))
    true = np.sqrt(np.mean((fused["albedo"] - 0.5) ** 2))
    assert true / 1.5 < np.median(fused["std_diffuse_albedo"]) < 1.5 * true
    spread = np.median(fused["disagreement_albedo"]) * 0.5
    assert noise / 1.5 < spread < 1.5 * noise


def test_a_camera_whose_pixels_blur_the_detail_counts_less():
    """Slopes between neighbours are what a pixel hides: the steeper of two noiseless maps is the less certain."""
    known = np.ones((6, 8), bool)
    ramp = np.arange(8, dtype=np.float32)[None, :, None] * np.ones((6, 1, 2), np.float32)
    assert np.allclose(square_slopes(0.1 * ramp, known), 2 * 0.01)
    known[:, 4] = False  # differences to what is not known are none
    assert square_slopes(np.where(known[..., None], ramp, 100), known)[2, 3] == pytest.approx(2)


def test_widths_in_gltf_are_the_fitted_ones():
    large, small = np.float32(0.4), np.float32(0.1)
    roughness, strength = in_gltf(np.array([(large * small) ** 0.25]), np.array([1 - small / large]))
    across = roughness[0] ** 2
    assert across == pytest.approx(small) and across + (1 - across) * strength[0] ** 2 == pytest.approx(large)


def test_what_no_camera_sees_is_smooth_and_what_one_sees_stays():
    rows, columns = (a.ravel() for a in np.indices((30, 30)))
    rng = np.random.default_rng(0)
    middle = (np.abs(rows - 15) < 8) & (np.abs(columns - 15) < 8)
    height = np.where(middle, rng.normal(size=900), 0.01 * rng.normal(size=900))
    at = (rows[:, None] * 30 + columns[:, None])[(rows < 29) & (columns < 29)]
    faces = np.concatenate([np.concatenate([at, at + 1, at + 30], 1), np.concatenate([at + 1, at + 31, at + 30], 1)])
    flat = np.stack([columns, -rows, height], -1).astype(float)
    attributes = {"coverage": np.where(middle, 0, 2), "normal": np.tile([0.0, 0, 1], (900, 1))}
    found = smoothed_where_unseen(Mesh(flat, faces, attributes))
    np.testing.assert_array_equal(found.vertices[~middle], flat[~middle])
    assert found.vertices[middle, 2].std() < 0.2 and np.median(found.attributes["normal"][middle, 2] ** 2) > 0.9
    finer = subdivided(Mesh(flat, faces))
    assert len(finer.faces) == 4 * len(faces) and finer.area().sum() == pytest.approx(Mesh(flat, faces).area().sum())


def written_stage(root, balls: list[Ball]) -> StageRun:
    """The decode and olat stages' folders of a light stage that shows the ball, and a run of the mesh stage over them."""
    cameras = {}
    for k, ball in enumerate(balls):
        name = f"cam{k:02d}"
        there = (ball.mask > 0.99) & (ball.distance > 0)
        size = ball.camera.width
        cameras[name] = {"camera": frame_of(ball.camera), "mask": None, "width": size, "height": size}
        constant = {"diffuse_albedo": ALBEDO, "specular_albedo": (SPECULAR,), "sigma": (SIGMA, SIGMA), "tangent": (0, 0, 0),
                    "std_diffuse_normal": (0.1,), "std_diffuse_albedo": (0.01,), "std_specular_albedo": (0.01,),
                    "std_sigma": (0.01,)}  # fmt: skip
        images = {key: there[..., None] * np.array(value, float) for key, value in constant.items()}
        images["normal"] = ball.normal * there[..., None]
        letters = {1: "Y", 2: "XY", 3: "XYZ"}
        for key, image in images.items():
            channels = "RGB" if key == "diffuse_albedo" else letters[image.shape[-1]]
            planes = {c: image[..., j].astype(np.float32) for j, c in enumerate(channels)}
            write_exr(root / "olat" / name / f"{key}.exr", planes)
        write_png(root / "masks" / f"{name}.png", ball.mask.astype(np.float32))
        zero = np.zeros(there.shape, np.float32)
        write_exr(root / "olat" / name / "residual.exr", {"Y": zero, "flag": zero})
    (root / "decode").mkdir()
    (root / "decode" / "olat.json").write_text(json.dumps({"cameras": cameras}))
    (root / "olat" / "maps.json").write_text(json.dumps({"lobe": "beckmann"}))
    inputs = {name: root / name for name in ("decode", "masks", "olat")}
    capture = SimpleNamespace(root=root, kind="light_stage", up="y", config=CaptureConfig())
    output = root / "mesh"
    output.mkdir()
    return StageRun(capture, MeshParameters(), inputs, output, root, progress=Progress(quiet=True))


@pytest.mark.slow
def test_a_light_stage_becomes_one_mesh_with_its_maps(tmp_path):
    radius = 12.0
    run = written_stage(tmp_path, ball_views(radius, 48))
    make_rig_mesh(run)
    ply = Ply(run.output / "mesh.ply")
    seen = ply.vertices(("coverage",))[:, 0] >= 2
    pixel = radius / (0.42 * 48)
    assert run.facts["voxel"] == pytest.approx(0.6 * pixel, rel=0.1)  # half of what depth images get
    away = np.abs(np.linalg.norm(ply.vertices(), axis=1) - radius)[seen] / pixel
    assert np.median(away) < 0.25 and np.quantile(away, 0.9) < 0.75
    normals = ply.vertices(("nx", "ny", "nz"))[seen]
    outward = ply.vertices()[seen] / np.linalg.norm(ply.vertices()[seen], axis=1, keepdims=True)
    assert np.degrees(np.median(np.arccos(np.clip((normals * outward).sum(1), -1, 1)))) < 1
    material = ply.vertices(("albedo_r", "albedo_g", "albedo_b", "specular", "sigma_x", "sigma_y"))
    assert np.allclose(np.median(material, 0), [*ALBEDO, SPECULAR, SIGMA, SIGMA], rtol=0.02)
    assert np.ptp(ply.vertices(), axis=0).max() < 2.4 * radius  # its back is a guess, but no spike of the hull's
    occlusion = ply.vertices(("occlusion",))[seen, 0]
    assert occlusion.min() > 0.9  # nothing shades a ball
    assert run.facts["cam00.disagreement_normal_deg"] < 1
    textures = run.output / "asset" / "textures"
    on = read_image(textures / "coverage.exr")[..., 0] == 1
    for name, value in {"albedo": ALBEDO, "specular": SPECULAR, "sigma_x": SIGMA, "sigma_y": SIGMA, "roughness": SIGMA**0.5,
                        "std_diffuse_albedo": 0.01, "anisotropy": 0, "tangent": 0}.items():  # fmt: skip
        assert np.allclose(np.median(read_image(textures / f"{name}.exr")[on], 0), value, rtol=0.02, atol=0.005), name
    upright = read_image(textures / "normal.exr")[on]  # a ball's own normals leave its normal map flat
    assert np.median(upright[:, 2]) > np.cos(np.radians(1)) and (textures / "std_sigma.png").is_file()
    facts = json.loads((run.output / "asset" / "asset.json").read_text())
    assert facts["lobe"] == "beckmann" and facts["textures"]["tangent"] and (run.output / "asset" / "asset.glb").is_file()
    camera = ball_views(radius, 48)[1].camera
    image = RigObject(run.output / "mesh.ply").render(camera, np.array([[0.0, 0, 1]]), np.ones((1, 3)))
    assert 0.1 < image[24, 24, 0] < 1 and not image[0, 0].any()


def test_two_cameras_are_no_surface(tmp_path):
    run = written_stage(tmp_path, ball_views(1.0, 16)[:2])
    with pytest.raises(UserError, match="only 2 cameras see the object"):
        make_rig_mesh(run)
