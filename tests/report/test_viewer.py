"""The report's viewer shows what the dataset holds: arrays arrive as they went in, and its picture is the pipeline's."""

from __future__ import annotations

import base64
import io
import json
import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from pipeline.asset.atlas import texels_of, unwrap
from pipeline.asset.bake import Textured
from pipeline.asset.filling import nearest_texel, texture
from pipeline.asset.glb import write_glb
from pipeline.asset.surface import in_metres
from pipeline.asset.tangents import in_tangent_frame, vertex_tangents
from pipeline.asset.texture_files import write_textures
from pipeline.formats.images import srgb_encode, write_exr
from pipeline.formats.ply import write_ply
from pipeline.geometry.cameras import Camera, camera_from_opengl
from pipeline.optics.sphere import latlong_solid_angles
from pipeline.report.render import render
from pipeline.rig.kept_samples import KeptSamples
from pipeline.rig.lobe_names import LOBES
from pipeline.rig.map_rendering import render_pixels
from pipeline.splats.cloud import SplatCloud
from pipeline.splats.splat_ply import write_splat_ply
from stages.metrics import report
from stages.metrics.report.viewer import packing, page, photographs, rig_scene
from stages.metrics.report.viewer.fit_data import ANGLES, Shown, fit_entry
from stages.metrics.report.viewer.light_data import light_entry, shrunk
from stages.metrics.report.viewer.model_scene import scene_of
from stages.metrics.report.viewer.splat_data import splat_entry
from stages.metrics.report.viewer.surface_data import ATTRIBUTES, IOR_RANGE, surface_entry, thinned
from synth.olat_pixels import rig_of
from synth.orbit import look_at

REPORT = Path(report.__file__).parent
CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
SIZE = 64


def sphere(rings: int = 24, bands: int = 48):
    """Vertices [V, 3] and outward triangles [F, 3] of a unit sphere."""
    theta, phi = np.meshgrid(np.linspace(0, np.pi, rings + 1), np.arange(bands) * 2 * np.pi / bands, indexing="ij")
    points = np.stack([np.sin(theta) * np.cos(phi), np.cos(theta), np.sin(theta) * np.sin(phi)], -1).reshape(-1, 3)
    r, b = np.meshgrid(np.arange(rings), np.arange(bands), indexing="ij")
    a, c = r * bands + b, r * bands + (b + 1) % bands
    faces = np.concatenate([np.stack([a, c, a + bands], -1), np.stack([c, c + bands, a + bands], -1)]).reshape(-1, 3)
    return points, faces


def baked(path: Path) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A sphere with a material that changes over it, as mesh.ply."""
    points, faces = sphere()
    albedo = 0.5 + 0.3 * points
    material = np.concatenate([albedo, 0.45 + 0.15 * points[:, :1], 1.5 + 0.1 * points[:, 1:2]], -1)
    attributes = np.concatenate([points, material], -1)
    columns = dict(zip(("x", "y", "z", *ATTRIBUTES), np.concatenate([points, attributes], -1).T))
    write_ply(path, columns, faces)
    return points, attributes, faces


def baked_in_an_atlas(folder: Path) -> None:
    """The same sphere as an asset, of few triangles whose textures know the true normals and the material."""
    points, faces = sphere(10, 20)
    a, b, c = (points[faces[:, k]] for k in range(3))
    faces = faces[np.linalg.norm(np.cross(b - a, c - a), axis=1) > 1e-9]  # those at the poles have no area, and so no texels
    atlas = unwrap(points, faces, 0.03, 512)
    position = points[atlas.source]
    tangent = vertex_tangents(position, position, atlas)
    texels = texels_of(atlas)
    upright, along = (texels.of(v, atlas.faces) for v in (position, tangent))
    upright /= np.linalg.norm(upright, axis=1, keepdims=True)
    bent = upright + 0.1 * np.cross(upright, [0.0, 1.0, 0.0])  # the texture's own normals, which the vertices do not have
    bent /= np.linalg.norm(bent, axis=1, keepdims=True)
    column = {"albedo": 0.5 + 0.3 * upright, "normal": in_tangent_frame(bent, upright, along)}
    column |= {"roughness": 0.45 + 0.15 * upright[:, :1], "ior": 1.5 + 0.1 * upright[:, 1:2]}
    column |= {"specular": 0 * upright[:, :1] + 0.04, "occlusion": 0 * upright[:, :1] + 1, "coverage": 0 * upright[:, :1] + 1}
    shape = (atlas.height, atlas.width)
    nearest = nearest_texel(texels.index, shape)
    maps = {name: texture(values, texels.index, nearest, shape) for name, values in column.items()}
    asset = in_metres(Textured(position, position, tangent, atlas.faces, atlas.uv, maps, 0.03, 0.0), "y", 0.5)
    folder.mkdir()
    write_glb(folder / "asset.glb", asset)
    write_textures(folder / "textures", asset.maps)
    (folder / "asset.json").write_text(json.dumps({"unit_m": 0.5}))


def sky() -> np.ndarray:
    """A map with a soft lamp."""
    v, u = np.meshgrid((np.arange(32) + 0.5) / 32, (np.arange(64) + 0.5) / 64, indexing="ij")
    lamp = np.exp(-((u - 0.4) ** 2 * 4 + (v - 0.35) ** 2) * 40)
    return 0.3 + np.stack([0.3 * (1 - v), 0.2 * u, 0.4 * v], -1) + 4 * lamp[..., None]


@pytest.mark.parametrize("kind", sorted(packing.KINDS))
def test_arrays_come_out_as_they_went_in(kind):
    values = np.arange(-60, 60).reshape(20, 6).astype(kind)
    assert np.array_equal(packing.unpacked(json.loads(json.dumps(packing.packed(values)))), values)


def test_directions_and_radiance_keep_their_digits():
    rng = np.random.default_rng(0)
    d = rng.normal(size=(500, 3))
    d /= np.linalg.norm(d, axis=-1, keepdims=True)
    d[:6] = np.concatenate([np.eye(3), -np.eye(3)])
    back = packing.unfolded(packing.octahedral(d))
    assert np.degrees(np.arccos(np.clip((back * d).sum(-1), -1, 1))).max() < 0.01
    light = np.exp(rng.normal(0, 5, (500, 3)))
    error = np.abs(packing.radiance_of(packing.rgbe(light)) - light).max(-1) / light.max(-1)
    assert error.max() < 0.005


@pytest.mark.parametrize("size", [(64, 128), (300, 600), (129, 258)])
def test_a_smaller_map_holds_the_same_light(size):
    light = np.random.default_rng(1).gamma(0.3, 5, (*size, 3))
    small = shrunk(light, 32)
    held = [(latlong_solid_angles(*m.shape[:2])[:, None, None] * m).sum((0, 1)) for m in (small, light)]
    assert small.shape == (32, 64, 3) and held[0] == pytest.approx(held[1], rel=2e-3)


def test_the_surface_in_the_page_is_that_of_the_mesh(tmp_path):
    points, attributes, faces = baked(tmp_path / "mesh.ply")
    turn = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])
    entry = surface_entry(tmp_path / "mesh.ply", turn)
    low, high = np.array(entry["low"]), np.array(entry["high"])
    position = low + packing.unpacked(entry["position"]) / 65535 * (high - low)
    assert np.abs(position - points @ turn.T).max() < 3e-5
    assert np.abs(packing.unfolded(packing.unpacked(entry["normal"])) - attributes[:, :3] @ turn.T).max() < 2e-4
    assert np.abs(packing.unpacked(entry["albedo"]) / 255 - srgb_encode(attributes[:, 3:6])).max() < 0.003
    material = packing.unpacked(entry["material"]) / 255
    assert np.abs(material[:, 0] - attributes[:, 6]).max() < 0.003
    assert np.abs(IOR_RANGE[0] + material[:, 1] * (IOR_RANGE[1] - IOR_RANGE[0]) - attributes[:, 7]).max() < 0.005
    assert np.array_equal(packing.unpacked(entry["index"]), faces)


def test_the_surface_in_an_atlas_is_that_of_the_asset_in_the_captures_units(tmp_path):
    baked_in_an_atlas(tmp_path / "asset")
    entry = surface_entry(tmp_path / "none.ply", np.eye(3), tmp_path / "asset")
    low, high = np.array(entry["low"]), np.array(entry["high"])
    position = low + packing.unpacked(entry["position"]) / 65535 * (high - low)
    assert np.abs(np.linalg.norm(position, axis=1) - 1).max() < 1e-4 and entry["triangles"] == entry["of"] > 300
    assert packing.unpacked(entry["uv"]).shape == (len(position), 2) and set(entry["pictures"]) == {"albedo", "surface"}
    assert np.abs(packing.unpacked(entry["albedo"]) / 255 - srgb_encode(0.5 + 0.3 * position)).max() < 0.06
    tangent = packing.unfolded(packing.unpacked(entry["tangent"])[:, :2])
    assert np.abs((tangent * position).sum(1)).max() < 0.02
    baked(tmp_path / "mesh.ply")
    assert "uv" not in surface_entry(tmp_path / "mesh.ply", np.eye(3), tmp_path / "no asset")


def test_hollows_see_less_of_the_sky_and_a_sphere_all_of_it(tmp_path):
    points, attributes, faces = baked(tmp_path / "mesh.ply")
    material = packing.unpacked(surface_entry(tmp_path / "mesh.ply", np.eye(3))["material"])
    assert material[:, 2].min() >= 250
    inside_out = attributes.copy()
    inside_out[:, :3] *= -1
    bowl = faces[(points[faces][:, :, 1] < 0).all(1)]
    columns = dict(zip(("x", "y", "z", *ATTRIBUTES), np.concatenate([points, inside_out], -1).T))
    write_ply(tmp_path / "bowl.ply", columns, bowl[:, ::-1])
    seen = packing.unpacked(surface_entry(tmp_path / "bowl.ply", np.eye(3))["material"])[:, 2] / 255
    rim = points[bowl][:, :, 1].max()  # a cone's share of the sky, weighted by the cosine; rays begin a little above the ground
    share = (1 - rim**2) / (1 - rim**2 + (1 + rim) ** 2)
    assert seen[points[:, 1] < -0.99].max() == pytest.approx(share, abs=0.07)


def test_a_thinned_surface_keeps_shape_and_material(tmp_path):
    points, attributes, faces = baked(tmp_path / "mesh.ply")
    few, values, corners = thinned(points, attributes, faces, 600)
    assert 300 < len(corners) <= 620 and len(few) == len(values) > corners.max()
    assert np.abs(np.linalg.norm(few, axis=1) - 1).max() < 0.03
    assert np.abs(values[:, 3:6] - (0.5 + 0.3 * few)).max() < 0.02


def test_sixty_thousand_triangles_and_forty_views_fit_the_page(tmp_path):
    rng = np.random.default_rng(2)
    arrays = [rng.integers(0, 60000, (30000, 5)).astype(np.uint16), rng.integers(0, 255, (30000, 5)).astype(np.uint8)]
    arrays.append(rng.integers(0, 30000, (60000, 3)).astype(np.uint16))
    size = sum(len(packing.packed(a)["data"]) for a in arrays)
    assert size + photographs.BUDGET * 4 / 3 < 9e6  # of 12 MB; the report's own pictures take the rest


def test_no_text_of_a_scene_ends_the_script_and_nothing_is_fetched():
    assert "</" not in page.embedded({"name": "</script><script>alert(1)"})
    fetched = r"https?://(?!www\.w3\.org/2000/svg')|import\(|fetch\(|XMLHttpRequest|console\."  # SVG's name is no address
    assert not re.search(fetched, page.script() + page.style())


def test_every_script_and_shader_of_the_folder_is_used():
    assert {p.stem for p in page.FOLDER.glob("*.js")} == set(page.SCRIPTS)
    shaders = {p.name for pattern in page.SHADERS for p in page.FOLDER.glob(pattern)}
    assert all(f"'{name}'" in page.script() for name in shaders)


def met(camera: Camera) -> tuple[np.ndarray, np.ndarray]:
    """Where the pixels' rays meet the unit sphere, [H, W, 3], 0 where they miss, and whether they do."""
    rays = camera.rays()
    b = rays @ camera.centre
    root = b**2 - (camera.centre @ camera.centre - 1)
    inside = root > 0
    return np.where(inside[..., None], camera.centre + rays * (-b - np.sqrt(np.maximum(root, 0)))[..., None], 0), inside


def light_stage(folder: Path, camera: Camera) -> np.ndarray:
    """Maps of a sphere with an anisotropic lobe, as the olat stage writes them; the pixels inside."""
    n, inside = met(camera)
    tangent = np.cross(n, [0.1, 1.0, 0.2])
    tangent /= np.maximum(np.linalg.norm(tangent, axis=-1, keepdims=True), 1e-9)
    folder.mkdir()

    def write(name, channels, values):
        write_exr(folder / f"{name}.exr", {c: np.float32(values[..., k] * inside) for k, c in enumerate(channels)})

    ones = np.ones((*inside.shape, 3))
    for name in ("diffuse_normal", "specular_normal"):
        write(name, "XYZ", n)
    write("tangent", "XYZ", tangent)
    write("diffuse_albedo", "RGB", 0.4 + 0.3 * n)
    write("specular_albedo", "Y", 0.05 * ones)
    write("sigma", "XY", np.stack([0.4 * ones[..., 0], 0.2 * ones[..., 0]], -1))
    for name in ("occlusion_d", "occlusion_s"):
        write(name, "Y", ones)
    return inside


def camera_at(position) -> Camera:
    pose = camera_from_opengl(look_at(np.array(position), np.zeros(3)))
    return Camera(SIZE, SIZE, 1.6 * SIZE, 1.6 * SIZE, SIZE / 2, SIZE / 2, pose)


def test_a_light_stages_maps_in_the_page_are_the_files(tmp_path):
    camera = camera_at([0.5, 0.4, 4.0])
    inside = light_stage(tmp_path / "cam00", camera)
    entry = rig_scene.camera_entry(tmp_path / "cam00", camera, 10**6)
    count = int(packing.unpacked(entry["inside"]).sum())
    assert count == inside.sum() and entry["step"] == 1
    view = packing.unfolded(packing.unpacked(entry["view"]))
    assert np.abs(view + camera.rays()[inside]).max() < 2e-4
    lobe = packing.unpacked(entry["lobe"]).view("<f2").astype(float)
    assert np.abs(lobe - [0.4, 0.2, 0.05]).max() < 1e-4
    fewer = rig_scene.camera_entry(tmp_path / "cam00", camera, count // 3)
    assert fewer["step"] == 2 and packing.unpacked(fewer["inside"]).sum() < 0.3 * count


def kept_samples(camera: Camera, lights: np.ndarray) -> KeptSamples:
    """What a few pixels of `light_stage`'s sphere would measure under lights [L, 3] of irradiance pi, by its own lobe."""
    n, inside = met(camera)
    pixels = np.flatnonzero(inside)[::40]
    normal, view = n.reshape(-1, 3)[pixels], -camera.rays_through(pixels)
    tangent = np.cross(normal, [0.1, 1.0, 0.2])
    tangent /= np.linalg.norm(tangent, axis=-1, keepdims=True)
    sigma, specular, albedo = (np.tile(v, (len(pixels), 1)) for v in ([0.4, 0.2], [0.05], [0.3, 0.4, 0.5]))
    cross, parallel = (np.zeros((len(pixels), len(lights), 3), np.float16) for _ in range(2))
    for k, light in enumerate(lights):
        found = render_pixels(
            LOBES["beckmann"], view, normal, normal, tangent, sigma, specular[:, 0], light[None], np.full((1, 3), np.pi), 0.0
        )
        diffuse = found[:, 0] * albedo / np.pi
        cross[:, k], parallel[:, k] = diffuse / 2, (diffuse + found[:, 1]) / 2
    numbers = {
        "diffuse_albedo": albedo, "specular_albedo": specular, "diffuse_normal": normal, "specular_normal": normal,
        "tangent": tangent, "sigma": sigma, "residual": np.zeros((len(pixels), 2)),
    }  # fmt: skip
    return KeptSamples(pixels, np.arange(len(lights)), cross, parallel, numbers)


def test_samples_in_the_page_lie_on_the_curves_of_the_fit(tmp_path):
    camera = camera_at([0.5, 0.4, 4.0])
    lights = rig_of(400).directions
    shown = Shown(np.full((400, 3), np.pi), lights, 2.0, LOBES["beckmann"])
    entry = fit_entry(kept_samples(camera, lights), camera, shown, "both", (0, 0), 1, 50)
    count = entry["at"]["shape"][0]
    normal, view = (packing.unfolded(packing.unpacked(entry[name])) for name in ("specular_normal", "view"))
    body, mirrored, curves = (packing.unpacked(entry[n]).view("<f2").astype(float) for n in ("body", "mirrored", "curves"))
    assert body.shape == mirrored.shape == (count, 400) and curves.shape == (count, 2, len(ANGLES))
    cosine = np.maximum(normal @ lights.T, 0)
    assert np.abs(body - 0.4 * cosine).max() < 2e-3
    k = int(np.argmax((normal * view).sum(-1)))  # seen squarely: the curves of both sides are alike
    half = lights + view[k]
    half /= np.linalg.norm(half, axis=-1, keepdims=True)
    angle = np.degrees(np.arccos(np.clip(half @ normal[k], -1, 1)))
    along, across = (np.interp(angle, ANGLES, curves[k, side]) for side in (0, 1))
    near = (angle < 30) & (cosine[k] > 0)
    low, high = np.minimum(along, across), np.maximum(along, across)
    slack = 0.03 * curves[k].max()
    assert near.sum() > 20 and (mirrored[k] > low - slack)[near].all() and (mirrored[k] < high + slack)[near].all()
    assert mirrored[k][near].max() > 0.7 * curves[k].max()


def shown_in_browser(folder: Path, scene: dict, draw: str) -> np.ndarray:
    """Bytes [SIZE, SIZE, 4] of the viewer's canvas after the script `draw` (of `v`), by the browser's software renderer."""
    macro = "rig_viewer" if scene["kind"] == "rig" else "model_viewer"
    (folder / "page.jinja").write_text(
        '{% from "viewer/viewer.html.jinja" import ' + macro + " %}"
        "<!doctype html><meta charset=utf-8><style>{{ look | safe }}</style><main>"
        "{{ " + macro + '(scene) }}</main><script type="application/json" id="viewer-scene">{{ text | safe }}</script>'
        "<script>{{ script | safe }}</script><script>(async () => { const root = document.getElementById('viewer');"
        " while (!root.viewer || !(root.viewer.light || root.viewer.ready)) await new Promise(r => setTimeout(r, 20));"
        " const v = root.viewer; v.pointer = null; " + draw + " const out = document.createElement('pre'); out.id = 'shot';"
        " out.textContent = v.canvas.toDataURL(); document.body.append(out); })()</script>"
    )
    shutil.copytree(REPORT / "viewer", folder / "viewer")
    context = {"scene": scene, "text": page.embedded(scene), "script": page.script(), "look": page.style()}
    text = render("page.jinja", context, folder)
    (folder / "page.html").write_text(text, encoding="utf-8")
    options = [
        "--headless",
        "--no-sandbox",
        "--disable-quic",
        "--no-first-run",
        "--disable-background-networking",
        "--disable-sync",
    ]
    options += ["--disable-component-update", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
    options += [
        f"--user-data-dir={folder / 'profile'}",
        "--virtual-time-budget=60000",
        "--dump-dom",
        f"file://{folder / 'page.html'}",
    ]
    done = subprocess.run([str(CHROMIUM), *options], capture_output=True, text=True, timeout=300, check=False)
    found = re.search(r'id="shot">data:image/png;base64,([^<]+)<', done.stdout)
    if not found:
        pytest.fail(f"the viewer drew nothing: {done.stderr[-400:]}")
    from PIL import Image

    return np.asarray(Image.open(io.BytesIO(base64.b64decode(found[1]))).convert("RGBA"))


def psnr(shown: np.ndarray, linear: np.ndarray, inside: np.ndarray) -> float:
    error = shown[..., :3] / 255 - srgb_encode(np.clip(linear, 0, 1))
    return float(-10 * np.log10((error[inside] ** 2).mean()))


def shaded_sphere(camera: Camera, light: np.ndarray, bend: float = 0.0) -> np.ndarray:
    """s0 [H, W, 3] of `baked`'s sphere under a map, by the pipeline's split sum; bend: of `baked_in_an_atlas`'s normals."""
    import torch

    from pipeline.shading import Prefilter, latlong, shade

    n, inside = met(camera)
    albedo, roughness, ior = 0.5 + 0.3 * n, 0.45 + 0.15 * n[..., 0], 1.5 + 0.1 * n[..., 1]
    bent = n + bend * np.cross(n, [0.0, 1.0, 0.0])
    bent /= np.maximum(np.linalg.norm(bent, axis=-1, keepdims=True), 1e-9)
    given = [x[inside] for x in (bent, -camera.rays(), albedo, roughness, ior, *camera.stokes_frame())]
    field = Prefilter(64).apply(torch.as_tensor(latlong.to_cube(light, 64), dtype=torch.float32))
    out = np.zeros((*inside.shape, 3))
    out[inside] = shade(*(torch.as_tensor(np.ascontiguousarray(x, np.float32)) for x in given), field).stokes[:, 0].numpy()
    return out


@pytest.mark.slow
@pytest.mark.skipif(CHROMIUM is None, reason="no Chromium to draw with")
@pytest.mark.parametrize("textured", [False, True])
def test_the_viewer_draws_the_model_as_the_pipeline_shades_it(tmp_path, textured):
    baked(tmp_path / "mesh.ply")
    if textured:
        baked_in_an_atlas(tmp_path / "asset")
    camera, light = camera_at([2.0, 1.2, 3.4]), sky()
    entry = {"name": "a", "test": False, "angle": None, "picture": "data:,", **photographs.pose_entry(camera, np.eye(3))}
    surface = surface_entry(tmp_path / "mesh.ply", np.eye(3), tmp_path / "asset")
    lights = [light_entry("sky", "sky", light)]
    scene = scene_of(surface, lights, "ggx", np.eye(3), [entry], 1.0)
    draw = (
        f"v.canvas.width = v.canvas.height = {SIZE}; v.state.camera = 0; v.state.exposure = 0;"
        " v.model.draw({place: v.place(), state: v.state, light: v.light, photograph: null});"
    )
    shown = shown_in_browser(tmp_path, scene, draw)
    image = shaded_sphere(camera, light, 0.1 * textured)
    inside = (shown[..., 3] == 255) & (image.min(-1) > 0)
    inside[1:-1, 1:-1] &= inside[:-2, 1:-1] & inside[2:, 1:-1] & inside[1:-1, :-2] & inside[1:-1, 2:]
    assert inside.sum() > 0.2 * SIZE**2
    assert psnr(shown, image, inside) > 34


def ball_of_discs(path: Path) -> SplatCloud:
    """Discs on the unit sphere whose colour changes over it and with the direction to the camera."""
    k = np.arange(6000) + 0.5
    y, angle = 1 - 2 * k / len(k), np.pi * (1 + np.sqrt(5)) * k
    n = np.stack([np.sqrt(1 - y * y) * np.cos(angle), y, np.sqrt(1 - y * y) * np.sin(angle)], -1)
    q = np.stack([1 + n[:, 2], -n[:, 1], n[:, 0], 0 * y], -1)
    coefficients = np.zeros((len(k), 16, 3))
    coefficients[:, 0] = 0.6 * n
    coefficients[:, 1], coefficients[:, 8], coefficients[:, 14] = 0.2, [0.1, 0, 0.2], [0, 0.1, 0]
    sigma = np.log(0.5 * np.sqrt(4 * np.pi / len(k)))
    scales = np.stack([0 * y + sigma, 0 * y + sigma, 0 * y - 9], -1)
    cloud = SplatCloud(n, q / np.linalg.norm(q, axis=1, keepdims=True), scales, 0 * y + 3.0, coefficients)
    write_splat_ply(path, cloud, ["sRGB colours of radiance divided by 0.5"])
    return cloud


def test_the_splats_in_the_page_are_those_of_the_file(tmp_path):
    cloud = ball_of_discs(tmp_path / "lit.ply")
    entry = splat_entry(tmp_path / "lit.ply", np.eye(3))
    normal = packing.unfolded(packing.unpacked(entry["normal"]))
    assert np.abs(normal - cloud.means).max() < 1e-3
    colour = packing.unpacked(entry["colour"]).reshape(-1, 16, 3) / 127 * np.array(entry["range"])[:, None]
    assert np.abs(colour - cloud.coefficients).max() < 0.005
    assert np.abs(packing.unpacked(entry["sigma"]).view("<f2").astype(float) - np.exp(cloud.log_scales[:, 0])).max() < 1e-4
    assert entry["white"] == 0.5 and splat_entry(tmp_path / "none.ply", np.eye(3)) is None


@pytest.mark.slow
@pytest.mark.skipif(CHROMIUM is None, reason="no Chromium to draw with")
def test_the_viewer_blends_the_splats_in_their_colours(tmp_path):
    baked(tmp_path / "mesh.ply")
    cloud, camera = ball_of_discs(tmp_path / "lit.ply"), camera_at([2.0, 1.2, 3.4])
    entry = {"name": "a", "test": False, "angle": None, "picture": "data:,", **photographs.pose_entry(camera, np.eye(3))}
    surface, lights = surface_entry(tmp_path / "mesh.ply", np.eye(3)), [light_entry("even", "even", np.ones((8, 16, 3)))]
    scene = scene_of(surface, lights, "ggx", np.eye(3), [entry], 1.0)
    scene["splats"] = splat_entry(tmp_path / "lit.ply", np.eye(3))
    draw = (
        f"v.canvas.width = v.canvas.height = {SIZE}; v.state.camera = 0; v.state.shown = 'splats'; v.state.exposure = 1;"
        " v.model.draw({place: v.place(), state: v.state, light: v.light, photograph: null});"
    )
    shown = shown_in_browser(tmp_path, scene, draw)
    where, inside = met(camera)
    colours = np.zeros((*inside.shape, 3))
    nearest = (where[inside] @ cloud.means.T).argmax(1)
    colours[inside] = np.clip(cloud.colours(camera.centre)[nearest], 0, 1)
    facing = inside & ((where * -camera.rays()).sum(-1) > 0.3)
    error = shown[..., :3] / 255 - colours
    assert facing.sum() > 0.2 * SIZE**2
    assert -10 * np.log10((error[facing] ** 2).mean()) > 30


@pytest.mark.slow
@pytest.mark.skipif(CHROMIUM is None, reason="no Chromium to draw with")
def test_the_viewer_lights_a_light_stages_maps_as_the_pipeline_does(tmp_path):
    from pipeline.rig.relighting import render_maps

    camera = camera_at([0.5, 0.4, 4.0])
    inside = light_stage(tmp_path / "cam00", camera)
    (tmp_path / "maps.json").write_text(json.dumps({"lobe": "beckmann"}))
    entry = {"name": "cam00", **rig_scene.camera_entry(tmp_path / "cam00", camera, 10**6)}
    scene = rig_scene.scene_of([entry], LOBES["beckmann"])
    width, height = entry["size"]
    draw = (
        f"v.canvas.width = {width}; v.canvas.height = {height}; v.state.x = 0.4; v.state.y = 0.3;"
        " v.rig.draw({camera: v.camera, state: v.state, window: [0.5, 0.5, 0.5, 0.5], direction: v.direction()});"
    )
    shown = shown_in_browser(tmp_path, scene, draw)
    right, up, back = np.array(entry["axes"])
    direction = 0.4 * right + 0.3 * up + np.sqrt(1 - 0.25) * back
    image = render_maps(tmp_path / "cam00", camera, direction[None], np.full((1, 3), np.pi))
    rows, columns = np.flatnonzero(inside.any(1)), np.flatnonzero(inside.any(0))
    top, left = rows[0] - (height - np.ptp(rows) - 1) // 2, columns[0] - (width - np.ptp(columns) - 1) // 2
    cut = (slice(top, top + height), slice(left, left + width))
    assert psnr(shown, image[cut], inside[cut]) > 45


@pytest.mark.slow
@pytest.mark.skipif(CHROMIUM is None, reason="no Chromium to draw with")
def test_a_click_shows_what_the_nearest_kept_pixel_measured(tmp_path):
    camera, lights = camera_at([0.5, 0.4, 4.0]), rig_of(60).directions
    light_stage(tmp_path / "cam00", camera)
    entry = {"name": "cam00", **rig_scene.camera_entry(tmp_path / "cam00", camera, 10**6)}
    shown = Shown(np.full((60, 3), np.pi), lights, 2.0, LOBES["beckmann"])
    corner = (entry["corner"][0], entry["corner"][1])
    entry["fits"] = fit_entry(kept_samples(camera, lights), camera, shown, "both", corner, entry["step"], 50)
    scene = rig_scene.scene_of([entry], LOBES["beckmann"], lights)
    draw = (
        "v.canvas.setPointerCapture = () => {};"  # which wants a real pointer
        "for (const what of ['pointerdown', 'pointerup'])"
        "  v.canvas.dispatchEvent(new PointerEvent(what, {...v.centre(), pointerId: 1, isPrimary: true}));"
        " const [lobe, body] = v.part('fit-charts').querySelectorAll('svg');"
        " const of = (svg, what) => svg.querySelectorAll(what).length, text = v.part('fit-text').textContent;"
        " const told = [of(lobe, 'circle') > 3, of(lobe, 'polyline') === 2, of(body, 'circle') > 20,"
        "  of(body, 'polyline') === 1, text.startsWith('cam00, column 3'), !v.part('fit').hidden];"
        " v.canvas.width = 6; v.canvas.height = 1; const g = v.rig.gl; g.viewport(0, 0, 6, 1); g.enable(g.SCISSOR_TEST);"
        " told.forEach((yes, k) => {"
        "  g.scissor(k, 0, 1, 1); g.clearColor(0, yes ? 1 : 0, 0, 1); g.clear(g.COLOR_BUFFER_BIT); });"
    )
    assert (shown_in_browser(tmp_path, scene, draw)[0, :, 1] == 255).tolist() == [True] * 6
