"""Error against run time: what is tried, what beats what, and what is predicted of several changes together."""

import json

import pytest

from stages.metrics.comparison.results import Result
from stages.metrics.tradeoff.choose import best_within, finest, pareto, predicted
from stages.metrics.tradeoff.knobs import trials
from stages.metrics.tradeoff.measure import Measured, errors, measured
from stages.metrics.tradeoff.page import scatter
from stages.metrics.tradeoff.run import FAST, FINE, Tradeoff, run_tradeoff

BASE = Measured({}, {"decode": 2.0, "train": 80.0, "mesh": 18.0}, 1.0)
SHORT = Measured({"train.iterations": 500}, {"decode": 2.0, "train": 30.0, "mesh": 18.0}, 1.3)
LONG = Measured({"train.iterations": 2400}, {"decode": 2.0, "train": 125.0, "mesh": 18.0}, 0.9)
SPLIT = Measured({"train.mirror": "split"}, {"decode": 2.0, "train": 56.0, "mesh": 18.0}, 1.1)
COARSE = Measured({"mesh.voxel_px": 2.0}, {"decode": 2.0, "train": 80.0, "mesh": 9.0}, 1.05)
SINGLES = [SHORT, LONG, SPLIT, COARSE]


def test_only_parameters_of_stages_that_ran_are_tried_and_none_with_its_present_value():
    tried = trials({"olat": {"lights": "all", "lobe": "ward", "precision": "float32"}})
    assert {t.parameter for t in tried} == {"olat.lights", "olat.precision"}


def test_a_pass_that_the_run_left_out_is_not_tried():
    parameters = {"train": {"iterations": 900, "indirect": "traced"}}
    assert "train.indirect" in {t.parameter for t in trials(parameters)}
    assert "train.indirect" not in {t.parameter for t in trials(parameters, ["train.indirect"])}


def test_steps_are_whole_and_relative_to_the_run_s_own():
    assert [t.text for t in trials({"train": {"iterations": 900}})] == [
        "train.iterations=300", "train.iterations=600", "train.iterations=1440",
    ]  # fmt: skip


def test_what_saves_time_is_tried_before_what_takes_more():
    tried = trials({"train": {"iterations": 900, "max_splats": 34000}, "mesh": {"voxel_px": 1.2}, "relight": {"cube": 128}})
    assert [t.cost > 1 for t in tried] == sorted(t.cost > 1 for t in tried) and len({t.stage for t in tried if t.cost < 1}) == 3


def test_errors_of_decibels_fall_as_they_rise_and_only_shared_figures_count():
    base = errors({"train": {"psnr_srgb": 30.0, "normal_mae_deg": 4.0}})
    run = measured(Result("a", {"train": {"psnr_srgb": 36.0}}, {"train": {"wall_s": 3.0}}), {}, base, {})
    assert run.error == pytest.approx(10 ** (-6 / 20))
    assert run.total == 3.0


def test_a_run_on_a_busy_machine_counts_as_long_as_it_would_have_taken_beside_the_user_s_own():
    taken = {"train": {"wall_s": 100.0, "cpu_s": 110.0, "compile_s": 0.0}}
    base = measured(Result("a", {}, taken), {}, {}, {})
    busy = {"train": {"wall_s": 400.0, "cpu_s": 75.0, "compile_s": 80.0}}
    run = measured(Result("b", {}, busy), {}, {}, base.pace)
    assert base.total == pytest.approx(100) and run.total == pytest.approx((75 - 80 * 75 / 400) * 100 / 110)


def test_the_pareto_curve_leaves_out_what_another_run_beats():
    worse = Measured({"train.indirect": "none"}, {"train": 90.0}, 1.4)
    assert [r.error for r in pareto([BASE, *SINGLES, worse])] == [1.3, 1.1, 1.05, 1.0, 0.9]


def test_changes_multiply_in_the_time_of_their_stage_and_in_the_error():
    seconds, error = predicted(BASE, [SHORT, SPLIT, COARSE])
    assert seconds == pytest.approx(2 + 80 * 30 / 80 * 56 / 80 + 9)
    assert error == pytest.approx(1.3 * 1.1 * 1.05)


def test_what_a_trial_took_longer_in_other_stages_is_the_machine_s():
    busy = Measured({"train.iterations": 500}, {"decode": 2.0, "train": 30.0, "mesh": 36.0}, 1.3)
    assert predicted(BASE, [busy])[0] == pytest.approx(50) and predicted(BASE, [LONG])[0] == pytest.approx(145)


def test_half_the_time_takes_the_combination_that_costs_least_error():
    assert best_within(BASE, SINGLES, 50.0) == {"train.iterations": 500}
    assert best_within(BASE, SINGLES, 45.0) == {"train.iterations": 500, "mesh.voxel_px": 2.0}
    assert best_within(BASE, SINGLES, 5.0) is None


def test_the_finest_takes_only_what_lowers_the_error():
    assert finest(BASE, SINGLES) == {"train.iterations": 2400}


def test_the_plot_has_a_point_for_every_run_with_its_parameters():
    svg = scatter([BASE, *SINGLES], pareto([BASE, *SINGLES]), lambda changed: " ".join(changed))
    assert svg.count("<circle") == 5 and "train.mirror: " in svg


result_extra: dict[str, float] = {}
"""Seconds that no parameter shortens, by stage."""


def made_up(changed):
    """A run whose time and errors follow its steps, splats and voxels."""
    steps, splats = changed.get("train.iterations", 1500), changed.get("train.max_splats", 34000)
    voxel, split = changed.get("mesh.voxel_px", 1.2), changed.get("train.mirror") == "split"
    train = 10 + result_extra.get("train", 0.0) + 0.06 * steps * (splats / 34000) ** 0.6 * (0.6 if split else 1.0)
    taken = {"decode": 2.0, "train": train, "mesh": 12 * (1.2 / voxel) ** 2}
    parameters = {
        "train": {"iterations": steps, "max_splats": splats, "mirror": "lobe-12", "indirect": "traced"},
        "mesh": {"voxel_px": voxel},
    }
    facts = {"train": {"indirect": {"run": False, "reason": "the object hides nothing"}}}
    manifests = {
        stage: {"wall_s": s, "cpu_s": s, "parameters": parameters.get(stage, {}), "facts": facts.get(stage, {})}
        for stage, s in taken.items()
    }
    rough = 2.0 * (1500 / steps) ** 0.3 * (34000 / splats) ** 0.1 * (1.05 if split else 1.0)
    metrics = {"train": {"normal_mae_deg": rough}, "mesh": {"chamfer_pct": 0.3 * (voxel / 1.2) ** 0.2}}
    return Result("views", metrics, manifests), sum(taken.values())


def test_time_is_kept_for_combinations_where_the_budget_ends_before_the_list(tmp_path, monkeypatch):
    """A third of the steps alone takes 0.6 of the run here: half the time needs two changes together."""

    def make(self, changed):
        result, seconds = made_up(changed)
        self.spent += 1.6 * seconds  # a machine that became busy
        return result

    monkeypatch.setattr(Tradeoff, "make", make)
    monkeypatch.setitem(result_extra, "train", 30.0)
    page = run_tradeoff(tmp_path / "views", tmp_path / "datasets" / "views", "", "", lambda line: None)
    table = json.loads(page.with_name("tradeoff.json").read_text())
    own = sum(table["base"]["seconds"].values())
    assert any(len(run["changed"]) > 1 and sum(run["seconds"].values()) <= 0.5 * own for run in table["runs"])
    assert table["lines"][FAST] is not None and 1.6 * sum(sum(run["seconds"].values()) for run in table["runs"]) <= 10 * own


def test_what_a_busier_machine_adds_to_a_trial_is_not_spent(tmp_path, monkeypatch):
    def make(self, changed):
        slow = 3.0 if changed else 1.0
        taken = {"decode": (2.0, 1.0, "a"), "train": (slow * 40.0, 40.0, f"b{changed}")}
        manifests = {s: {"wall_s": w, "cpu_s": c, "compile_s": 0.0, "key": k} for s, (w, c, k) in taken.items()}
        self.spent += slow * 40.0 + 3.0
        return Result("views", {"train": {"normal_mae_deg": 2.0}}, manifests)

    monkeypatch.setattr(Tradeoff, "make", make)
    work = Tradeoff(tmp_path, tmp_path, "", "", lambda line: None)
    first = work.make({})
    work.base, work.spent, work.made = measured(first, {}, errors(first.metrics), {}), 0.0, {"a", "b{}"}
    assert work.try_out({"train.mirror": "split"}).total == pytest.approx(42) and work.spent == pytest.approx(41)


def test_a_multi_view_capture_gets_both_lines_within_ten_times_its_own_time(tmp_path, monkeypatch, capsys):
    tried = []

    def make(self, changed):
        result, seconds = made_up(changed)
        tried.append(dict(changed))
        self.spent += seconds
        return result

    monkeypatch.setattr(Tradeoff, "make", make)
    page = run_tradeoff(tmp_path / "views", tmp_path / "datasets" / "views", "", "", lambda line: None)
    table = json.loads(page.with_name("tradeoff.json").read_text())
    own = sum(table["base"]["seconds"].values())
    runs = {json.dumps(run["changed"], sort_keys=True): run for run in table["runs"]}
    assert sum(sum(run["seconds"].values()) for run in table["runs"]) <= 10 * own
    assert {"train.iterations", "train.max_splats", "mesh.voxel_px"} <= {name for changed in tried for name in changed}
    assert not any("train.indirect" in changed for changed in tried)  # the run left that out
    said = capsys.readouterr().out
    for line in (FAST, FINE):
        changed = table["lines"][line]
        assert f'{line}: PARAMS="{changed}"' in said
        words = dict(word.split("=") for word in changed.split())
        run = next(r for r in runs.values() if {k: str(v) for k, v in r["changed"].items()} == words)
        assert sum(run["seconds"].values()) <= 0.5 * own if line == FAST else run["error"] < 1
    assert "<svg" in page.read_text()
