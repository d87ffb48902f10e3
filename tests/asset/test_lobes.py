"""Programs that know one lobe get the roughness of theirs that is nearest to ours."""

from __future__ import annotations

import json
import xml.etree.ElementTree as xml
from dataclasses import replace

import numpy as np
import pytest

from pipeline.asset.asset import write_asset
from pipeline.asset.lobes import GGX_FROM_GAUSSIAN, ggx_roughness
from pipeline.formats.images import read_image
from pipeline.optics.fresnel import normal_reflectance

RENDERERS = ("asset.mtlx", "asset.mtl", "blender.py")


def slopes_apart(ratio: float) -> float:
    """Squared difference of a Gaussian's slope density and a GGX lobe's of `ratio` times its alpha, over the plane."""
    t = (np.arange(400_000) + 0.5) * 1e-4
    return float(((np.exp(-(t**2)) / np.pi - ratio**2 / np.pi / (ratio**2 + t**2) ** 2) ** 2 * t).sum())


def test_the_ratio_is_that_of_the_nearest_lobe():
    assert slopes_apart(GGX_FROM_GAUSSIAN) < min(slopes_apart(GGX_FROM_GAUSSIAN * k) for k in (0.999, 1.001))
    r = np.float32([0.2, 0.5])
    assert ggx_roughness(r, "beckmann") ** 2 / r**2 == pytest.approx([GGX_FROM_GAUSSIAN] * 2, rel=1e-5)
    assert ggx_roughness(r, "ggx") is r


@pytest.fixture(scope="module")
def uneven(baked):
    """The ball with one texel of a much higher index."""
    ior = baked.maps["ior"].copy()
    row, column = np.argwhere(baked.maps["coverage"][..., 0] > 0)[0]
    ior[row, column] = 2.0
    return replace(baked, maps={**baked.maps, "ior": ior, "specular": normal_reflectance(ior)}), (row, column)


@pytest.fixture(scope="module", params=["ggx", "beckmann"])
def folder(request, uneven, tmp_path_factory):
    """The lobe, and an asset that was fitted with it."""
    out = tmp_path_factory.mktemp(request.param)
    write_asset(out, uneven[0], "y", 1.0, np.zeros(3), lobe=request.param)
    return request.param, out


def test_renderers_read_the_roughness_of_their_lobe_and_mitsuba_our_own(folder):
    lobe, out = folder
    name = "roughness" if lobe == "ggx" else "roughness_ggx"
    assert all(f"textures/{name}.exr" in (out / file).read_text() for file in RENDERERS)
    scene = xml.parse(out / "asset.xml")
    assert {e.get("value") for e in scene.iter("string") if e.get("name") == "distribution"} == {lobe}
    table = json.loads((out / "asset.json").read_text())
    assert table["lobe"] == lobe
    assert ("roughness_ggx" in table["textures"]) == (lobe != "ggx")
    known = read_image(out / "textures" / f"{name}.exr") / read_image(out / "textures" / "roughness.exr")
    assert np.median(known) == pytest.approx(1 if lobe == "ggx" else GGX_FROM_GAUSSIAN**0.5, rel=2e-3)


def test_one_texel_of_a_high_index_leaves_the_body_of_all_others_as_bright(folder, uneven):
    out = folder[1]
    found = {e.get("value") for e in xml.parse(out / "asset.xml").iter("float") if e.get("name") == "int_ior"}
    assert found == {"1.50000"}
    share = read_image(out / "textures" / "mitsuba_specular.exr")[..., 0]
    assert share[uneven[1]] == pytest.approx(
        float(normal_reflectance(np.array(2.0)) / normal_reflectance(np.array(1.5))), rel=1e-3
    )
    assert np.median(share) == pytest.approx(1, abs=1e-3)


def test_the_obj_names_normals_and_reflectance_as_blender_reads_them(folder):
    out = folder[1]
    text = (out / "asset.mtl").read_text()
    assert "map_Bump -bm 1 textures/normal_map.exr" in text
    assert "norm textures/normal_map.exr" in text
    assert "map_Ks textures/obj_specular.exr" in text
    index = float(next(line.split()[1] for line in text.splitlines() if line.startswith("Ni ")))
    level = 2 * np.median(read_image(out / "textures" / "obj_specular.exr"))
    assert level * normal_reflectance(np.array(index)) == pytest.approx(0.04, rel=1e-2)
