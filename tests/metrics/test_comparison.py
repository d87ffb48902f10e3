"""Results side by side: what is best, what is missing, what differs, and what cannot be compared."""

import json

import pytest

from pipeline.errors import UserError
from stages.metrics.comparison.results import Result, read_results
from stages.metrics.comparison.tables import as_text, cost_lines, figure_lines, parameter_lines


def result(name, metrics, **manifest):
    return Result(name, metrics, {"train": {"wall_s": 10.0, "cpu_s": 18.0, "peak_rss_mb": 900.0, **manifest}})


def test_higher_psnr_and_lower_error_are_best_and_neutral_figures_have_no_best():
    a = result("a", {"train": {"psnr_srgb": 30.0, "normal_mae_deg": 3.0, "ior_mean": 1.5}})
    b = result("b", {"train": {"psnr_srgb": 32.0, "normal_mae_deg": 4.0, "ior_mean": 1.4}})
    assert {line.name: line.best for line in figure_lines([a, b])} == {"psnr_srgb": 1, "normal_mae_deg": 0, "ior_mean": None}


def test_a_figure_that_one_result_lacks_is_a_dash_and_wins_nothing():
    a, b = result("a", {"relight": {"studio": {"psnr_srgb": 30.0, "views": []}}}), result("b", {})
    (line,) = figure_lines([a, b])
    assert (line.group, line.best, line.texts[1]) == ("relight, studio", None, "–")


def test_costs_are_summed_and_memory_is_the_largest():
    a = Result("a", {}, {s: {"wall_s": 2.0, "cpu_s": 3.0, "peak_rss_mb": m} for s, m in (("decode", 100.0), ("train", 700.0))})
    total = {line.name: line.values[0] for line in cost_lines([a]) if line.group == "all"}
    assert total == {"wall_s": 4.0, "cpu_s": 6.0, "peak_rss_mb": 700.0}


def test_only_parameters_that_differ_are_shown():
    a, b = (result(n, {}, parameters={"iterations": k, "seed": 0}) for n, k in (("a", 500), ("b", 800)))
    assert [(line.name, line.values) for line in parameter_lines([a, b])] == [("iterations", [500, 800])]


def test_the_terminal_s_table_marks_the_best():
    a, b = result("a", {"train": {"ssim": 0.9}}), result("b", {"train": {"ssim": 0.8}})
    assert as_text(figure_lines([a, b]), ["a", "b"]).splitlines()[1].split("  ")[1].endswith("*")


def test_what_is_no_dataset_or_has_no_results_is_named(tmp_path):
    with pytest.raises(UserError, match=r"none: is no dataset"):
        read_results([tmp_path / "none"])
    (tmp_path / "dataset.json").write_text(json.dumps({}))
    with pytest.raises(UserError, match=r"has no results to compare"):
        read_results([tmp_path])
