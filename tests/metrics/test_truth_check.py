"""Ground truth that metrics could not use is named before anything runs."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from pipeline.capture import Capture, LightStage, LightStageCamera, LightTable
from pipeline.errors import UserError
from pipeline.formats.images import write_exr
from pipeline.formats.ply import write_ply
from pipeline.geometry.cameras import Camera
from stages.metrics.truth_check import check_truth

SHAPE = (6, 8)
MAPS = {"mask": np.ones(SHAPE), "normal": np.ones((*SHAPE, 3)), "albedo": np.ones((*SHAPE, 3)), "dp_du": np.ones((*SHAPE, 3))}


@pytest.fixture
def capture(tmp_path) -> Capture:
    camera = Camera(SHAPE[1], SHAPE[0], 9.0, 9.0, 4.0, 3.0, np.eye(4))
    lights = LightTable(np.eye(3), np.eye(3), np.ones(3), None)
    stage = LightStage(tmp_path, {"cam00": LightStageCamera("cam00", (), (), None, camera)}, lights)
    (tmp_path / "cam00" / "gt").mkdir(parents=True)
    (tmp_path / "gt").mkdir()
    return Capture(tmp_path, "light_stage", "light_stage", "polarisers", light_stage=stage)


def fault(capture: Capture, path: Path) -> str:
    with pytest.raises(UserError) as caught:
        check_truth(capture, [path])
    assert path.name in str(caught.value) and "\n" not in str(caught.value)
    return str(caught.value)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"normal": None}, "has no normal"),
        ({"normal": np.ones((5, 8, 3))}, "8x5"),
        ({"albedo": np.ones(SHAPE)}, "albedo has the shape"),
        ({"mask": np.array([object()])}, "mask"),
        ({"mask": np.ones(3)}, "mask has the shape"),
        ({"dp_du": np.ones((*SHAPE, 2))}, "dp_du"),
    ],
)
def test_maps_of_another_shape_are_named(capture, change, words):
    path = capture.root / "cam00" / "gt" / "maps.npz"
    np.savez(path, **MAPS, unread=np.ones(5))
    check_truth(capture, [path])
    np.savez(path, **{k: v for k, v in (MAPS | change).items() if v is not None})
    assert words in fault(capture, path)
    path.write_bytes(path.read_bytes()[:200])
    assert "cannot be read" in fault(capture, path)


@pytest.mark.parametrize(
    ("name", "good", "bad"),
    [
        ("gt_brdf.json", {"sigma": [0.1, 0.2]}, ({}, {"sigma": [1]}, {"sigma": [0, 1]}, {"sigma": ["a", 1]}, [], 3)),
        ("gt_lp.json", {"true_angles_deg": [1, 2.5]}, ({}, {"true_angles_deg": 3}, {"true_angles_deg": [None]}, "x")),
        ("gt/polarisers.json", {"A": 3.0}, ({"A": "3"}, {"A": {}}, [1])),
        ("gt/material.json", {"ior": 1.5, "alpha": None}, ({"ior": "x"}, {"alpha": -1}, {"ior": True})),
    ],
)
def test_documents_of_another_shape_are_named(capture, name, good, bad):
    path = capture.root / name
    path.write_text(json.dumps(good))
    check_truth(capture, [path])
    for value in bad:
        path.write_text(json.dumps(value))
        fault(capture, path)
    for text in ("{", "[" * 100_000, ""):
        path.write_text(text)
        assert "JSON" in fault(capture, path)


def test_images_and_meshes_that_cannot_be_used_are_named(capture):
    path = capture.root / "gt" / "normal" / "000.exr"
    write_exr(path, {c: np.ones((64, 64), np.float32) * np.arange(64) for c in "XYZ"})
    check_truth(capture, [path])
    path.write_bytes(path.read_bytes()[:-40])
    fault(capture, path)
    write_exr(path, {"Y": np.ones((4, 4))})
    assert "no channel X" in fault(capture, path)
    mesh = capture.root / "gt" / "mesh.ply"
    corners = np.eye(3)
    write_ply(mesh, dict(zip("xyz", corners)), np.array([[0, 1, 2]]))
    check_truth(capture, [mesh])
    good = mesh.read_bytes()
    mesh.write_bytes(good[:-5])
    assert "truncated" in fault(capture, mesh)
    mesh.write_text("solid")
    assert "not a PLY" in fault(capture, mesh)
    cases = (("xyz", [0, 1, 3], "names vertex 3 of 3"), ("xyw", [0, 1, 2], "have no z"), ("xyz", [], "no triangle"))
    for columns, face, words in cases:
        write_ply(mesh, dict(zip(columns, corners)), np.array(face, int).reshape(-1, 3))
        assert words in fault(capture, mesh)
