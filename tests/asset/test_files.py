"""What other programs read of an asset: the same surface, in metres, y up, in every file."""

from __future__ import annotations

import json
import struct
import xml.etree.ElementTree as xml
import zipfile

import numpy as np
import pytest

from pipeline.asset.asset import FORMATS, write_asset
from pipeline.asset.surface import asset_from_world, in_metres
from pipeline.formats.images import read_image, srgb_decode
from pipeline.optics.fresnel import hemispherical_transmittance

UP, UNIT_M = "z", 0.01


@pytest.fixture(scope="module")
def folder(baked, tmp_path_factory):
    """An asset of the ball, taken in centimetres with z up."""
    out = tmp_path_factory.mktemp("files") / "asset"
    write_asset(out, baked, UP, UNIT_M, np.array([5.0, 0, 0]))
    return out


@pytest.fixture(scope="module")
def expected(baked):
    """Positions [W, 3] that every file should hold."""
    return baked.position @ asset_from_world(UP, UNIT_M)[:3, :3].T


def glb_parts(path):
    """The document and the binary chunk of a GLB."""
    content = path.read_bytes()
    magic, version, length = struct.unpack_from("<III", content)
    size, kind = struct.unpack_from("<II", content, 12)
    assert (magic, version, length, kind) == (0x46546C67, 2, len(content), 0x4E4F534A)
    start = 20 + size
    binary, kind = struct.unpack_from("<II", content, start)
    assert (kind, start + 8 + binary) == (0x004E4942, len(content))
    return json.loads(content[20:start]), content[start + 8 :]


def accessor(document, binary, number):
    """The floats of an accessor [N, C]."""
    entry = document["accessors"][number]
    view = document["bufferViews"][entry["bufferView"]]
    wide = {"VEC2": 2, "VEC3": 3, "VEC4": 4}[entry["type"]]
    return np.frombuffer(binary, "<f4", entry["count"] * wide, view["byteOffset"]).reshape(-1, wide)


def test_glb_holds_the_surface_in_metres_with_y_up(folder, expected, baked):
    document, binary = glb_parts(folder / "asset.glb")
    at = document["meshes"][0]["primitives"][0]["attributes"]
    found = accessor(document, binary, at["POSITION"])
    assert np.allclose(found, expected, atol=1e-6)
    assert np.allclose(document["accessors"][at["POSITION"]]["max"], found.max(0))
    assert np.allclose(accessor(document, binary, at["TEXCOORD_0"]), baked.uv, atol=1e-6)
    assert np.allclose(np.linalg.norm(accessor(document, binary, at["TANGENT"])[:, :3], axis=1), 1, atol=1e-5)
    extensions = document["materials"][0]["extensions"]
    assert extensions["KHR_materials_ior"]["ior"] == pytest.approx(1.5, abs=1e-3)
    assert set(document["extensionsUsed"]) == set(extensions)
    assert all(v["byteOffset"] % 4 == 0 for v in document["bufferViews"])


def test_glb_and_obj_are_read_by_open3d_alike(folder, expected):
    import open3d as o3d

    for name in ("asset.glb", "asset.obj"):
        mesh = o3d.io.read_triangle_mesh(str(folder / name))
        points = np.asarray(mesh.vertices)
        assert np.allclose(sorted(points.max(0)), sorted(expected.max(0)), atol=1e-5), name
        assert np.allclose(points.mean(0), expected.mean(0), atol=2e-4), name
        assert mesh.has_triangle_uvs()


def test_usdz_is_packed_as_programs_map_it_and_says_its_axes(folder, expected):
    from pxr import Usd, UsdGeom

    with zipfile.ZipFile(folder / "asset.usdz") as package:
        for entry in package.infolist():
            head = entry.header_offset
            name, extra = struct.unpack_from("<HH", (folder / "asset.usdz").read_bytes(), head + 26)
            assert (head + 30 + name + extra) % 64 == 0
            assert entry.compress_type == zipfile.ZIP_STORED
    stage = Usd.Stage.Open(str(folder / "asset.usdz"))
    assert UsdGeom.GetStageUpAxis(stage) == "Y"
    assert UsdGeom.GetStageMetersPerUnit(stage) == 1.0
    points = np.array(UsdGeom.Mesh(stage.GetPrimAtPath("/asset/mesh")).GetPointsAttr().Get())
    assert np.allclose(points, expected, atol=1e-6)


def test_every_file_that_one_names_is_there(folder):
    named = [n.get("value") for n in xml.parse(folder / "asset.mtlx").iter("input") if n.get("type") == "filename"]
    for scene in ("asset.xml", "asset_polarised.xml"):
        named += [n.get("value") for n in xml.parse(folder / scene).iter("string") if n.get("name") == "filename"]
    named += [w for line in (folder / "asset.mtl").read_text().splitlines() for w in line.split() if "/" in w]
    named += list(json.loads((folder / "asset.json").read_text())["textures"].values())
    named += [name for names in FORMATS.values() for name in names]
    assert len(named) > 20
    missing = [name for name in named if name != "$envmap" and not (folder / name).exists()]
    assert missing == []


def test_the_script_for_blender_compiles_and_takes_the_textures_that_are_there(folder):
    text = (folder / "blender.py").read_text()
    compile(text, "blender.py", "exec")
    assert '"Base Color": ("textures/base_color.exr", True)' in text
    assert "#TEXTURES#" not in text


def test_textures_agree_in_png_and_exr(folder, baked):
    png, exr = (read_image(folder / "textures" / f"albedo.{end}") for end in ("png", "exr"))
    assert np.allclose(srgb_decode(png), exr, atol=1e-3)
    assert np.allclose(read_image(folder / "textures" / "ior.png") * 2 + 1, baked.maps["ior"], atol=1e-4)
    assert np.allclose(read_image(folder / "textures" / "normal.png") * 2 - 1, baked.maps["normal"], atol=1e-4)


def test_base_colour_is_the_albedo_with_the_loss_on_the_way_in(baked):
    asset = in_metres(baked, "y", None)
    ratio = asset.maps["base_color"] / asset.maps["albedo"]
    assert np.allclose(ratio, hemispherical_transmittance(np.array(1.5)), atol=1e-3)


def test_the_same_surface_gives_the_same_bytes(folder, baked, tmp_path):
    write_asset(tmp_path, baked, UP, UNIT_M, np.array([5.0, 0, 0]))
    for path in sorted(folder.rglob("*.*")):
        assert path.read_bytes() == (tmp_path / path.relative_to(folder)).read_bytes(), path.name


def test_what_was_taken_off_and_how_to_get_back_is_told(folder):
    table = json.loads((folder / "asset.json").read_text())
    assert table["world_offset"] == [5.0, 0, 0]
    assert table["unit_m"] == UNIT_M
    assert np.allclose(np.array(table["asset_from_world"]) @ [0, 0, 1, 1], [0, 0.01, 0, 1])


def test_mitsuba_renders_the_ball_as_bright_as_its_pattern_in_a_white_room(baked, tmp_path):
    import mitsuba as mi

    write_asset(tmp_path, baked, "y", None, np.zeros(3), np.ones((4, 8, 3), np.float32))
    mi.set_variant("scalar_rgb")
    scene = mi.load_file(str(tmp_path / "asset.xml"), resx=16, resy=16, spp=16)
    image = np.array(mi.render(scene, integrator=mi.load_dict({"type": "path", "hide_emitters": True})))[..., :3]
    middle = image[6:10, 6:10].mean((0, 1))
    seen = in_metres(baked, "y", None).maps["base_color"]
    inside = baked.maps["coverage"][..., 0] > 0
    assert np.abs(middle - (0.96 * seen[inside].mean(0) + 0.045)).max() < 0.15  # 1 - F of the body, F of the room
