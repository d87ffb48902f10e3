"""`polarfield.open` gives what the stages left, as arrays, and says in one line what is missing."""

from __future__ import annotations

import json

import numpy as np
import pytest

import polarfield
from pipeline.engine.dataset import Dataset
from pipeline.formats.images import write_exr, write_mask
from pipeline.formats.ply import write_ply
from pipeline.geometry.cameras import Camera, save_cameras

KEY = "0123456789abcdef"


@pytest.fixture
def dataset(tmp_path):
    """One view of 6 x 4 pixels as the stages leave it, one map of a light-stage camera, each stage's version in use."""
    root = tmp_path / "d"
    Dataset(root).prepare()
    ramp = np.arange(24, dtype=np.float32).reshape(4, 6)
    stages = ("decode", "poses", "masks", "train", "mesh", "relight", "olat", "metrics")
    at = {name: tmp_path / "made" / name for name in stages}
    for folder in at.values():
        folder.mkdir(parents=True)
    stokes = {f"S{i}.{c}": ramp * (i + 1) for i in range(3) for c in "RGB"}
    save_cameras(at["poses"] / "cameras.json", {"a": Camera(6, 4, 9.0, 9.0, 3.0, 2.0, np.eye(4))}, {"a": "a.exr"})
    (at["decode"] / "frames").mkdir()
    write_exr(at["decode"] / "frames/a.exr", stokes)
    write_mask(at["masks"] / "a.png", ramp > 3)
    for folder, more in (("gbuffer", {}), ("test", stokes)):
        (at["train"] / folder).mkdir()
        write_exr(at["train"] / folder / "a.exr", {"alpha": ramp, "depth": 2 * ramp, **more})
    write_exr(at["train"] / "env.exr", {c: ramp for c in "RGB"})
    write_ply(at["train"] / "gaussians.ply", {"x": np.arange(3.0), "y": np.zeros(3), "z": np.ones(3), "roughness": np.ones(3)})
    corners = {"x": np.array([0, 1, 0.0]), "y": np.array([0, 0, 1.0]), "z": np.zeros(3), "ior": np.full(3, 1.5)}
    write_ply(at["mesh"] / "mesh.ply", corners, np.array([[0, 1, 2]]))
    (at["relight"] / "sky").mkdir()
    write_exr(at["relight"] / "sky" / "a.exr", {c: 3 * ramp for c in "RGB"})
    (at["olat"] / "cam00").mkdir()
    write_exr(at["olat"] / "cam00" / "sigma.exr", {"X": ramp, "Y": ramp})
    (at["metrics"] / "metrics.json").write_text(json.dumps({"schema": 1, "train": {"psnr": 30.0}}))
    for name, folder in at.items():
        paths = [p for p in folder.rglob("*") if p.is_file()]
        files = [{"path": str(p.relative_to(folder)), "bytes": p.stat().st_size, "digest": ""} for p in paths]
        made = Dataset(root).publish(
            name, KEY, folder, {"schema": 1, "stage": name, "key": KEY, "inputs": {}, "outputs": files}
        )
        Dataset(root).use(made)
    return root


def test_everything_that_stages_leave_is_an_array(dataset):
    d = polarfield.open(dataset)
    ramp = np.arange(24, dtype=np.float32).reshape(4, 6)
    assert set(d.stages) == {"decode", "poses", "masks", "train", "mesh", "relight", "olat", "metrics"}
    assert "train" in repr(d) and d.views == d.test_views == ["a"] and d.cameras["a"].fx == 9
    assert np.array_equal(d.image("a")[:, :, 1, 2], 2 * ramp)
    assert d.mask("a").dtype == bool and d.mask("a").sum() == 20
    assert {"alpha", "S2.B"} <= set(d.buffers("a")) and np.array_equal(d.buffers("a")["depth"], 2 * ramp)
    assert d.splats()["roughness"].tolist() == [1, 1, 1] and d.environment.shape == (4, 6, 3)
    vertices, triangles, properties = d.mesh()
    assert vertices.shape == (3, 3) and triangles.tolist() == [[0, 1, 2]] and properties["ior"][0] == 1.5
    assert d.environments == ["sky"] and np.array_equal(d.relit("sky", "a")[..., 0], 3 * ramp)
    assert d.maps("cam00")["sigma"].shape == (4, 6, 2) and d.textures() == {}
    assert d.metrics["train"]["psnr"] == 30 and d.facts("train")["key"] == KEY


def test_what_is_not_there_is_said_in_one_line(dataset, tmp_path):
    d = polarfield.open(str(dataset))
    with pytest.raises(polarfield.UserError, match=r"holds nothing of 'b'.*a"):
        d.image("b")
    with pytest.raises(polarfield.UserError, match="nothing of 'room'"):
        d.relit("room", "a")
    with pytest.raises(polarfield.UserError, match="nothing of 'cam01'"):
        d.maps("cam01")
    (dataset / "mesh" / KEY / "mesh.ply").unlink()
    with pytest.raises(polarfield.UserError, match="no results of the mesh stage"):
        d.mesh()
    with pytest.raises(polarfield.UserError, match="no such dataset"):
        polarfield.open(tmp_path / "none")
