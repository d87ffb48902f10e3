"""A stored result of a benchmark was made with today's defaults, or says with which others."""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import asdict
from pathlib import Path
from typing import Any

import pytest

from pipeline.engine.stage import parameters_from
from pipeline.shading import prefilter, splitsum
from stages.calib.decode.parameters import DecodeParameters
from stages.calib.poses.parameters import PosesParameters
from stages.masks.parameters import MasksParameters
from stages.mesh.parameters import MeshParameters
from stages.olat.parameters import OlatParameters
from stages.relight.mesh_shadows import TRANSFER_TEXELS
from stages.relight.parameters import RelightParameters
from stages.train.parameters import TrainParameters
from stages.train.render_view import LAYER, SCREEN_FILTER
from stages.train.splats.splat_occlusion import DIFFUSE_RAYS
from stages.train.stage import STAGE

ROOT = Path(__file__).parents[2]
RESULTS = ROOT / "benchmarks" / "results"


def stored(name: str) -> dict[str, Any]:
    """A benchmark's results; of one that has not been run, none."""
    path = RESULTS / f"{name}.json"
    return json.loads(path.read_text(encoding="utf-8")) if path.exists() else {"captures": {}}


BY_NAME = ("assets", "textures")  # rows by name, each with what it was made with
TRAIN, LIGHT, ABLATION = (stored(name) for name in ("train", "light", "ablation"))
TRAIN_NOW = TrainParameters()
ROWS = [(capture, row) for capture, rows in ABLATION["captures"].items() for row in rows]


def changed(then: dict[str, Any], now: dict[str, Any]) -> dict[str, list[Any]]:
    """[then, now] of what differs, by name; null where there is none of that name."""
    return {name: [then.get(name), now.get(name)] for name in then | now if then.get(name) != now.get(name)}


def flat(table: dict[str, Any]) -> dict[str, Any]:
    """The table with those in it taken apart: STAGE.NAME."""
    parts = {f"{k}.{n}": v for k, inner in table.items() if isinstance(inner, dict) for n, v in inner.items()}
    return parts | {k: v for k, v in table.items() if not isinstance(v, dict)}


@pytest.mark.parametrize("capture", sorted(TRAIN["captures"]))
def test_stored_trainings_say_which_defaults_have_changed_since(capture):
    """`defaults_since`: [then, now] by parameter; null where there is none of that name."""
    since = changed(TRAIN["captures"][capture]["stokes"]["parameters"], asdict(TrainParameters()))
    assert TRAIN.get("defaults_since", {}) == since, "run `make bench-train`, or say in the file what has changed"


@pytest.mark.parametrize("capture", sorted(TRAIN["captures"]))
def test_a_piece_that_was_changed_changed_something(capture):
    runs = TRAIN["captures"][capture]
    figures = {name: [{k: v for k, v in row.items() if k != "train_s"} for row in run["curve"]] for name, run in runs.items()}
    same = [name for name, curve in figures.items() if name != "all pieces" and curve == figures["all pieces"]]
    assert same == [], "these rows switch nothing off: leave them out"


@pytest.mark.parametrize(("capture", "row"), ROWS)
def test_stored_rows_of_the_ablation_say_which_defaults_have_changed_since(capture, row):
    kept = ABLATION["captures"][capture][row]
    given = {name: str(value) for name, value in kept["given"].items()}
    now = asdict(parameters_from(STAGE, given, "ablation.json"))
    since = changed(kept["parameters"], now)
    assert ABLATION.get("defaults_since", {}).get(row, {}) == since, "run `make bench-ablation`, or say what has changed"


def test_stored_approximations_were_measured_with_today_s_defaults_and_mark_them():
    cases = stored("approximations").get("cases", {})
    train = TrainParameters()
    nodes = [splitsum.ROUGHNESS_NODES, splitsum.COSINE_NODES, splitsum.IOR_NODES]
    now = {
        "fresnel": train.fresnel, "split_sum_nodes": nodes, "environment_resolution": train.environment_resolution,
        "diffuse_resolution": prefilter.DIFFUSE_RESOLUTION, "occlusion_rays": DIFFUSE_RAYS, "lobe": train.lobe,
    }  # fmt: skip
    stale = [name for name, case in cases.items() if case["defaults"] != now]
    assert not stale, "run `make bench-approximations`"
    groups = {name.partition(",")[0] for name in cases}
    assert groups == {name.partition(",")[0] for name, case in cases.items() if case["default"]}, "a default was not measured"


def test_stored_meshes_were_made_with_today_s_defaults_and_mark_them():
    cases, mesh = stored("mesh").get("cases", {}), MeshParameters()
    now = {"voxel_px": mesh.voxel_px, "poisson_depth": mesh.poisson_depth}
    assert not [name for name, case in cases.items() if case["defaults"] != now], "run `make bench-mesh`"
    assert {f"voxel of {mesh.voxel_px} px", f"depth {mesh.poisson_depth}"} == {
        name.rpartition(", ")[2] for name, case in cases.items() if case["default"]
    }


@pytest.mark.parametrize(
    ("name", "now"),
    [
        ("decode", DecodeParameters()), ("masks", MasksParameters()), ("poses", PosesParameters()), ("olat", OlatParameters()),
        ("overexposure", OlatParameters()),
        ("rasterize", {"screen_filter": SCREEN_FILTER, "layer": LAYER}),
        ("shading", {"mirror": TRAIN_NOW.mirror, "environment_resolution": TRAIN_NOW.environment_resolution}),
        ("assets", {"train": asdict(TRAIN_NOW), "mesh": asdict(MeshParameters()), "relight": asdict(RelightParameters())}),
        ("textures", {"train": asdict(TRAIN_NOW), "mesh": asdict(MeshParameters())}),
    ],
)  # fmt: skip
def test_what_a_stored_result_says_it_was_made_with_is_today_s(name, now):
    """Results from before that was kept say so on their page."""
    found = stored(name)
    listed = found if isinstance(found, list) else list(found.values()) if name in BY_NAME else [found]
    made = [row.get("made") for row in listed]
    table = json.loads(json.dumps(now if isinstance(now, dict) else asdict(now)))
    since = [(m.get("defaults_since", {}), changed(flat(m["defaults"]), flat(table))) for m in made if m]
    assert all(said == found for said, found in since), f"run `make bench-{name}`, or say in `made` what has changed"


def test_stored_errors_of_light_were_measured_with_what_relighting_does_today():
    relight = RelightParameters()
    now = {"cube": relight.cube, "mirror": relight.mirror, "transfer": TRANSFER_TEXELS, "lobe": TrainParameters().lobe}
    then = {name: LIGHT["settings"][name] for name in now}
    assert LIGHT.get("defaults_since", {}) == changed(then, now), "run `make bench-light`, or say what has changed"
    assert all(found["choices"] for found in LIGHT["captures"].values())


def test_the_pages_of_figures_say_what_the_stored_results_say():
    """Whoever changes a stored number or a page by hand, and not the other, is told."""
    done = subprocess.run([sys.executable, "-m", "benchmarks.report", "--check"], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
