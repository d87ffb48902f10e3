"""Files that no stage leaves are told from those that one does, whatever a manifest says of them."""

from __future__ import annotations

import json

import numpy as np
import pytest

from pipeline.formats.images import write_exr
from pipeline.formats.ply import write_ply
from pipeline.formats.result_check import FORMS, fault_of_result, fault_of_table, sizes_of

RIG_CAMERA = {"width": 4, "height": 4, "camera": {}, "cross": ["a"], "parallel": ["b"], "mask": None}
LIGHTS = {"directions": [[0, 1, 0]], "positions": [[0, 2.5, 0]], "intensity": [1], "solid_angle": None}
VIEW = {
    "file": "frames/0.exr",
    "width": 4,
    "height": 4,
    "camera": "camera",
    "noise": None,
    "saturated": None,
    "design": [[1.0]],
}
SOUND = {
    "frames.json": {"schema": 1, "polarisation": "stokes", "views": {"0": VIEW}, "parts": None},
    "olat.json": {"cameras": {"0": RIG_CAMERA}, "lights": LIGHTS},
    "masks.json": {"views": {"0": {"coverage": 0.5}}},
    "polarisers.json": {"camera": {"angle_deg": 12.0, "trusted": True}},
    "lighting.json": {"up": "-z", "fresnel": "exact", "lobe": "ggx", "occlusion": True, "indirect": "traced"},
    "maps.json": {"lobe": "ward"},
    "asset.json": {"unit_m": None, "texture_size": [64, 64]},
    "metrics.json": {"schema": 1},
}  # fmt: skip


@pytest.mark.parametrize("name", sorted(FORMS))
def test_tables_of_every_form_pass_as_stages_write_them_and_of_another_shape_they_do_not(name, tmp_path):
    path = tmp_path / name
    path.write_text(json.dumps(SOUND[name]))
    assert fault_of_table(path) is None
    for text in ("", "[]", "3", '"x"', "[" * 100_000):
        path.write_text(text)
        assert fault_of_table(path)


@pytest.mark.parametrize(
    ("name", "keys", "value"),
    [
        ("frames.json", ("views",), 3), ("frames.json", ("views", "0"), "x"), ("frames.json", ("views", "0", "width"), 1e308),
        ("frames.json", ("views", "0", "noise"), {}), ("frames.json", ("parts",), [1]), ("olat.json", ("cameras", "0"), 1),
        ("olat.json", ("cameras", "0", "cross"), ["../x"]),
        ("olat.json", ("lights", "directions"), [[0, 1]]),
        ("frames.json", ("views", "0", "saturated"), "/etc/passwd"),
        ("masks.json", ("views", "0", "coverage"), "x"), ("polarisers.json", ("camera", "angle_deg"), []),
        ("lighting.json", ("up",), "w"), ("lighting.json", ("lobe",), 3), ("lighting.json", ("occlusion",), "yes"),
        ("maps.json", ("lobe",), "cosine"), ("asset.json", ("unit_m",), "metre"),
    ],
)  # fmt: skip
def test_a_value_of_another_type_is_named(name, keys, value, tmp_path):
    table = json.loads(json.dumps(SOUND[name]))
    inner = table
    for key in keys[:-1]:
        inner = inner[key]
    inner[keys[-1]] = value
    path = tmp_path / name
    path.write_text(json.dumps(table))
    assert keys[-1] in str(fault_of_table(path))


def test_pictures_and_surfaces_without_finite_numbers_are_told(tmp_path):
    image = np.ones((4, 4), np.float32)
    write_exr(tmp_path / "a.exr", {"Y": image})
    assert fault_of_result(tmp_path / "a.exr", {}) is None
    image[0, 0] = np.nan
    write_exr(tmp_path / "a.exr", {"Y": image})
    assert "no numbers" in str(fault_of_result(tmp_path / "a.exr", {}))
    corner = {n: np.array([0.0, 1.0, float(n == "y")]) for n in "xyz"}
    write_ply(tmp_path / "a.ply", corner, np.array([[0, 1, 2]]))
    assert fault_of_result(tmp_path / "a.ply", {}) is None
    write_ply(tmp_path / "a.ply", corner, np.array([[0, 1, 3]]))
    assert "vertex 3" in str(fault_of_result(tmp_path / "a.ply", {}))
    write_ply(tmp_path / "a.ply", {**corner, "x": np.array([0, np.inf, 0])})
    assert "not finite" in str(fault_of_result(tmp_path / "a.ply", {}))


def test_a_picture_of_another_size_than_its_view_is_told(tmp_path):
    for name in ("frames.json", "olat.json"):
        (tmp_path / name).write_text(json.dumps(SOUND[name]))
    sizes = sizes_of(tmp_path.iterdir())
    assert sizes == {"0": (4, 4)}
    for name, size in {
        "0": (4, 8),
        "0_olat": (4, 2),
        "0/normal": (2, 2),
        "0/sigma": (4, 4),
        "1": (9, 9),
        "path/0": (9, 9),
    }.items():
        path = tmp_path / f"{name}.exr"
        path.parent.mkdir(exist_ok=True)
        write_exr(path, {"Y": np.ones(size, np.float32)})
        told = fault_of_result(path, sizes)
        assert told is None if size in ((4, 4), (9, 9)) else told == f"is {size[1]}x{size[0]}, its view 4x4"
