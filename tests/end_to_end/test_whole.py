"""The whole pipeline on the tiny captures: every promised file, no work twice, exactly what depends redone."""

from __future__ import annotations

import importlib.util
import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from pipeline.formats.images import channel_names, read_exr

from .conftest import QUICK, ROOT, polarfield

pytestmark = pytest.mark.slow
STOKES = {f"S{k}.{c}" for k in range(3) for c in "RGB"}
TEST = STOKES | {"N.X", "N.Y", "N.Z", "roughness", "ior", "alpha", "depth"}
TEST |= {f"{part}.{c}" for part in ("albedo", "diffuse", "specular") for c in "RGB"}
VIEWS = [f"{k:03d}" for k in range(16)]


def versions(root: Path) -> dict[str, str]:
    """Version in use of every stage."""
    return {p.parent.name: os.readlink(p) for p in root.glob("*/current")}


def finite(path: Path) -> bool:
    return all(np.isfinite(a).all() for a in read_exr(path).values())


def test_views_leave_every_promised_file(views_dataset):
    root = views_dataset
    assert set(versions(root)) == {"decode", "poses", "masks", "train", "mesh", "relight", "metrics"}
    frames = root / "decode" / "current" / "frames"
    assert sorted(p.stem for p in frames.glob("*.exr")) == VIEWS
    assert len(json.loads((root / "poses/current/cameras.json").read_text())["frames"]) == 16
    assert (root / "poses/current/sparse").is_dir()
    train = root / "train" / "current"
    assert sorted(p.stem for p in (train / "test").glob("*.exr")) == ["000", "008"]
    for name in ("000", "008"):
        assert set(channel_names(train / "test" / f"{name}.exr")) >= TEST
        assert finite(train / "test" / f"{name}.exr")
    assert sorted(p.stem for p in (train / "gbuffer").glob("*.exr")) == VIEWS
    for name in ("gaussians.ply", "env.exr", "polarisers.json", "train_log.csv", "lighting.json"):
        assert (train / name).stat().st_size > 0
    assert sorted(p.stem for p in (root / "relight/current/studio").glob("*.exr")) == VIEWS
    assert set(channel_names(root / "relight/current/studio/003.exr")) == STOKES
    assert finite(root / "relight/current/studio/003.exr")
    assert (root / "mesh/current/mesh.ply").stat().st_size > 10_000


def test_the_notebook_reads_the_dataset(views_dataset):
    """Its cells, run as a script; those that draw where there is something to draw with."""
    notebook = json.loads((ROOT / "docs" / "reading.ipynb").read_text())
    cells = ["".join(cell["source"]) for cell in notebook["cells"] if cell["cell_type"] == "code"]
    draws = importlib.util.find_spec("matplotlib") is not None
    script = "\n".join(cell for cell in cells if draws or "matplotlib" not in cell)
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "POLARFIELD_DATASET": str(views_dataset), "MPLBACKEND": "agg"}
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, env=environment)
    assert done.returncode == 0, done.stderr
    assert "mean DoLP on the object" in done.stdout and "Gaussians" in done.stdout


def test_figures_are_sound_even_after_a_very_short_training(views_dataset):
    metrics = json.loads((views_dataset / "metrics/current/metrics.json").read_text())
    assert metrics["train"]["psnr_srgb"] > 17  # a black image has 11
    assert metrics["train"]["normal_mae_deg"] < 25
    assert metrics["mesh"]["chamfer_pct"] < 4
    assert metrics["relight"]["studio"]["psnr_srgb"] > 15
    assert [row["view"] for row in metrics["train"]["views"]] == ["000", "008"]
    for stage in ("decode", "train", "mesh", "relight"):
        assert metrics[stage]["wall_s"] > 0
        assert metrics[stage]["peak_rss_mb"] > 10


def test_report_is_one_self_contained_page(views_dataset, stage_dataset):
    for root in (views_dataset, stage_dataset):
        page = (root / "metrics/current/report.html").read_text()
        assert page.count("data:image/png;base64,") >= 12
        assert not re.findall(r"(?:src|href)=[\"']?(?:https?:)?//", page)
        assert str(root) not in page


def test_light_stage_leaves_maps_and_relit_images_without_torch_or_jax(stage_dataset):
    root = stage_dataset
    assert set(versions(root)) == {"decode", "masks", "olat", "relight", "metrics"}
    for name in ("diffuse_albedo", "normal", "tangent", "sigma", "residual", "visibility_d", "interreflection_d"):
        assert finite(root / "olat/current/cam00" / f"{name}.exr")
    for name in ("cam00", "cam00_olat"):
        assert {"R", "G", "B"} <= set(channel_names(root / "relight/current/studio" / f"{name}.exr"))
    metrics = json.loads((root / "metrics/current/metrics.json").read_text())
    assert metrics["olat"]["cam00"]["diffuse_normal"]["median"] < 2
    assert metrics["olat"]["cam00"]["albedo_rel_median"] < 0.05
    assert metrics["relight"]["studio"]["maps_vs_frames_psnr"] > 20
    for stage in ("decode", "masks", "olat", "relight"):
        packages = json.loads((root / stage / "current" / "manifest.json").read_text())["packages"]
        assert not {"torch", "jax"} & set(packages)


def test_plan_is_kept_with_its_reasons(views_dataset, stage_dataset):
    plan = json.loads((views_dataset / "dataset.json").read_text())["plan"]
    assert not plan["olat"]["run"] and plan["olat"]["reason"]
    assert plan["train"]["passes"]["polariser_angles"]["run"] is False
    plan = json.loads((stage_dataset / "dataset.json").read_text())["plan"]
    assert [name for name, d in plan.items() if not d["run"]] == ["poses", "train", "mesh"]


def test_second_run_does_nothing_in_under_two_seconds(captures, views_dataset):
    before = {p: p.stat().st_mtime_ns for p in views_dataset.rglob("*") if p.is_file() and ".work" not in p.parts}
    runs = [polarfield("all", captures / "views", "--dataset", views_dataset, "--params", QUICK) for _ in range(3)]
    assert all(r.status == 0 and "nothing to do" in r.out for r in runs)
    assert min(r.seconds for r in runs) < 2
    after = {p: p.stat().st_mtime_ns for p in views_dataset.rglob("*") if p.is_file() and ".work" not in p.parts}
    assert before == after


def test_a_changed_parameter_redoes_exactly_what_depends_on_it(captures, views_dataset):
    before = versions(views_dataset)
    changed = QUICK + " mesh.voxel_px=2"
    assert polarfield("all", captures / "views", "--dataset", views_dataset, "--params", changed).status == 0
    after = versions(views_dataset)
    assert {s for s in before if before[s] != after[s]} == {"mesh", "relight", "metrics"}
    assert (views_dataset / "mesh" / before["mesh"] / "mesh.ply").exists()
    assert polarfield("all", captures / "views", "--dataset", views_dataset, "--params", QUICK).status == 0
    assert versions(views_dataset) == before


def test_one_stage_alone_makes_what_it_needs_and_no_more(captures, tmp_path):
    outcome = polarfield("masks", captures / "views", "--dataset", tmp_path / "d")
    assert outcome.status == 0
    assert set(versions(tmp_path / "d")) == {"decode", "poses", "masks"}
    assert (tmp_path / "d/masks/current/000.png").exists()


def test_dataset_can_be_moved(captures, views_dataset, tmp_path):
    shutil.copytree(views_dataset, tmp_path / "moved", symlinks=True)
    again = polarfield("all", captures / "views", "--dataset", tmp_path / "moved", "--params", QUICK)
    assert "nothing to do" in again.out


def test_inspection_writes_a_page_and_no_dataset(captures, tmp_path):
    outcome = polarfield("inspect", captures / "views", "--dataset", tmp_path / "d")
    assert outcome.status == 0, outcome.err
    page = (tmp_path / "d-inspect" / "inspect.html").read_text()
    assert page.count("data:image/png;base64,") >= 12
    assert not (tmp_path / "d").exists()


def test_given_maps_are_relit_beside_the_captures_own(captures, stage_dataset, tmp_path):
    extra = tmp_path / "dusk map.hdr"
    shutil.copy(captures / "views" / "gt" / "env.hdr", extra)
    done = polarfield("all", captures / "stage", "--dataset", stage_dataset, "--envs", f"'{extra}'")
    assert done.status == 0, done.err
    assert {p.name for p in (stage_dataset / "relight/current").iterdir() if p.is_dir()} == {"studio", "dusk map"}


def test_maps_of_one_name_are_refused(captures, stage_dataset, tmp_path):
    shutil.copy(captures / "views" / "gt" / "env.hdr", tmp_path / "studio.hdr")
    refused = polarfield("all", captures / "stage", "--dataset", stage_dataset, "--envs", tmp_path / "studio.hdr")
    assert refused.status == 2
    assert "same name" in refused.err


def test_stage_modules_are_commands_too(captures, tmp_path):
    import subprocess

    for module, text in (("stages.mesh", "voxel"), ("stages.relight", "turntable"), ("stages.metrics", "samples")):
        shown = subprocess.run([sys.executable, "-m", module, "--help"], capture_output=True, text=True, timeout=60)
        assert shown.returncode == 0
        assert text in shown.stdout
