"""A run is foretold at rates that this machine has shown, and what a plan leaves out carries what it would have cost."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import pytest

from pipeline.engine import cli
from pipeline.engine.costs import COMPILING, ITSELF, Cost, rates
from pipeline.engine.costs.probe import cores, machine, slowness
from pipeline.engine.costs.rates import Rates, Record, record_of, remember, remembered
from pipeline.engine.stage import Decision


def record(key: str, estimate: float, cpu: float, wall: float | None = None, version: int = 1) -> Record:
    return Record(key, estimate, cpu, cpu if wall is None else wall, version)


@pytest.fixture(autouse=True)
def cache(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    return tmp_path / "cache" / "polarfield" / "rates.json"


def test_before_any_run_the_machine_s_speed_and_cores_tell_the_rate():
    rate = Rates().of("train", "cpu", 100.0, 1, parallel=1.0)
    assert rate.cpu == pytest.approx(slowness()) and rate.wall == pytest.approx(1 / cores()) and not rate.known
    assert 0.05 < slowness() < 50


def test_a_run_as_large_tells_the_rate_and_one_a_hundred_times_smaller_hardly():
    found = Rates()
    found.add("train", "cpu", record("a", 1.0, 50 * slowness()))
    far = found.of("train", "cpu", 100.0, 1, 0.0)
    near = found.of("train", "cpu", 1.0, 1, 0.0)
    assert far.cpu / slowness() == pytest.approx(50 ** (0.01 / 0.26)) and near.cpu / slowness() == pytest.approx(50**0.8)
    assert near.known and not found.of("train", "cuda", 1.0, 1, 0.0).known
    assert found.of("train", "cpu", 1.0, 2, 0.0).cpu < near.cpu  # another version of the stage left it


def test_what_else_the_machine_did_meanwhile_does_not_last():
    found = Rates()
    found.add("train", "cpu", record("busy", 100.0, 100.0, 900.0))
    assert found.of("train", "cpu", 100.0, 1, 0.0).wall <= rates.ALONE and found.of("train", "cpu", 1e4, 1, 0.0).wall < 1.1
    found.add("train", "cpu", record("alone", 90.0, 100.0, 60.0))
    assert found.of("train", "cpu", 100.0, 1, 0.0).wall == pytest.approx(0.6)


def test_small_runs_push_no_large_one_out_and_a_version_counts_once():
    found = Rates()
    found.add("train", "cpu", record("large", 300.0, 600.0))
    for k in range(50):
        found.add("train", "cpu", record(f"{min(k, 39)}", 1.0, 1.0))
    assert [r.key for r in found.records["train@cpu"]] == ["large", "37", "38", "39"]


def test_what_is_remembered_is_read_again_and_damage_is_forgotten(cache):
    remember("train", "cpu", record("a", 2.0, 3.0, 4.0))
    remember("mesh", "cpu", record("b", 1.0, 1.0))
    assert remembered().records == {"train@cpu": [record("a", 2.0, 3.0, 4.0)], "mesh@cpu": [record("b", 1.0, 1.0)]}
    table = json.loads(cache.read_text())
    table["machines"][machine()]["mesh@cpu"] = [{"key": "b", "estimate_s": "1", "cpu_s": 1, "wall_s": 1, "version": 1}, 7]
    table["machines"]["another"] = table["machines"][machine()]
    cache.write_text(json.dumps(table))
    assert list(remembered().records) == ["train@cpu"]
    cache.write_text("{")
    assert remembered().records == {}
    remember("mesh", "cpu", record("b", 1.0, 1.0))
    assert list(remembered().records) == ["mesh@cpu"]


def test_rates_of_other_estimates_are_forgotten(cache):
    remember("mesh", "cpu", record("a", 1.0, 2.0))
    assert remembered().records
    cache.write_text(cache.read_text().replace(f'"schema": {rates.SCHEMA}', '"schema": 1'))
    assert not remembered().records
    remember("mesh", "cpu", record("b", 1.0, 2.0))
    assert [r.key for r in remembered().records["mesh@cpu"]] == ["b"]


def test_rates_that_cannot_be_kept_stop_nothing(cache, monkeypatch):
    cache.parent.parent.write_text("a file where the folder should be")
    remember("train", "cpu", record("a", 2.0, 3.0))
    assert remembered().records == {}
    monkeypatch.setattr(rates, "place", lambda: None)
    remember("train", "cpu", record("a", 2.0, 3.0))
    assert remembered().records == {}


def test_a_manifest_counts_on_its_own_machine_without_what_compiling_took():
    manifest = {"machine": machine(), "key": "a", "version": 3, "cpu_s": 12.0, "wall_s": 24.0, "compile_s": 4.0}
    assert record_of(manifest, 5.0) == Record("a", 5.0, 10.0, 20.0, 3)
    assert record_of({**manifest, "compile_s": 20.0}, 5.0) is None  # what is left of it is no rate
    assert record_of({**manifest, "machine": "another"}, 5.0) is None
    assert record_of({**manifest, "cpu_s": "x"}, 5.0) is None and record_of({}, 5.0) is None


@pytest.fixture
def costly(command):
    """Stages that tell what they take: `count` with a pass that runs and one that does not, `never` with what it would."""
    stages = cli.load_stages({})
    passes = {"deep": Decision(True, "asked for"), "wide": Decision(False, "nothing is wide")}
    costs = {"deep": Cost(1.0), "wide": Cost(60.0, 40.0), "rare": Cost(9.0), COMPILING: Cost(4.0)}
    needed = lambda c, p: Decision(True, "always", passes)  # noqa: E731
    stages["count"] = dataclasses.replace(stages["count"], needed=needed, costs=lambda c, p: {ITSELF: Cost(2.0), **costs})
    stages["never"] = dataclasses.replace(stages["never"], costs=lambda c, p: {ITSELF: Cost(30.0, 500.0), "more": Cost(9.0)})
    return command, stages


def test_the_plan_foretells_the_run_and_what_leaving_out_saves(costly, capture):
    command, _ = costly
    s = slowness()
    said = command("plan", capture.root, "--dataset", "d").out
    assert f"[{rates_text(7 * s)}]" in said and f"{rates_text(7 * s)} in all" in said
    assert f"without wide: nothing is wide (saves {rates_text(60 * s)}, 40 MB)" in said
    assert f"no need (saves {rates_text(30 * s)}, 500 MB)" in said
    assert "(a first estimate: no run on this machine has shown its speed yet)" in said


def rates_text(seconds: float) -> str:
    from pipeline.engine.progress import brief

    return f"about {brief(seconds)}"


def test_a_run_keeps_what_was_foretold_and_shows_the_rate_of_the_next(costly, capture, monkeypatch):
    command, stages = costly
    told = {}
    whole = stages["metrics"].run
    stages["metrics"] = dataclasses.replace(stages["metrics"], run=lambda run: (told.update(run.left_out), whole(run)))
    monkeypatch.setattr("pipeline.engine.costs.rates.SHORTEST_S", 0.0)
    command("all", capture.root, "--dataset", "d")
    manifest = json.loads(Path("d/count/current/manifest.json").read_text())
    assert manifest["expected_wall_s"] == pytest.approx(7 * slowness(), rel=1e-3) and manifest["machine"] == machine()
    assert set(told) == {"count.wide", "count.rare", "never"}  # the rare pass was decided on while it ran
    assert told["count.wide"]["saved_mb"] == 40.0 and told["count.wide"]["reason"] == "nothing is wide"
    assert told["never"]["saved_s"] == pytest.approx(30 * slowness(), rel=1e-3)
