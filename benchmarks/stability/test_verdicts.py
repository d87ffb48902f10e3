"""A case of `make stability` fails by the rules that its page states: planted faults are found, sound cases are not blamed."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from benchmarks.stability import functions, fused, light_stage, options, repeats, whole_runs
from benchmarks.stability.page import TITLES, page
from benchmarks.stability.verdicts import Row
from benchmarks.stability.whole_runs import Ended, row
from pipeline.optics import fresnel

BASE = {"psnr_foreground": 20.0, "likeness": 0.9, "surface_pct": 1.0}
SOUND = Ended(0, "", [], dict(BASE), [])
UNSEEN = "the underside of the object is seen by no view"


def why(name, **changed):
    found = row(name, "12 views", replace(SOUND, **changed), BASE)
    assert found.sound == (found.why == "")
    return found.why


def test_a_run_that_ends_finite_near_the_truth_is_sound():
    assert why("base") == "" == why("world x 1e4")


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"status": None}, "has not ended"),
        ({"status": 1}, "exit status 1"),
        ({"errors": "Traceback (most recent call last)"}, "a traceback"),
        ({"status": 2, "errors": "polarfield: a.exr: no"}, "refused"),
        ({"bad_files": ["relight/a.exr"]}, "relight/a.exr holds values that are not finite"),
        ({"figures": {**BASE, "surface_pct": 2.1}}, "2.1 % of its size off (a pixel is 2.0 %) without a word"),
        ({"figures": {**BASE, "psnr_foreground": 13.0}}, "unseen views have 13.0 dB without a word"),
    ],
)
def test_each_fault_of_a_run_is_named(changed, words):
    assert words in why("base", **changed)


def test_a_wrong_surface_is_excused_by_a_warning_that_doubts_it_and_by_no_other():
    off = {**BASE, "surface_pct": 3.1}
    assert why("underside that no view sees", figures=off, warnings=[UNSEEN]) == ""
    assert "without a word" in why("underside that no view sees", figures=off, warnings=["splats_lit.spz: 55 % of the splats"])


def test_what_must_be_refused_is_refused_in_one_line_and_nothing_else_is():
    line = "polarfield: /somewhere/000.exr: every pixel is black"
    assert why("black", status=2, errors=line) == "" and why("needle 1.5 pixels thick", status=2, errors=line) == ""
    assert row("black", "", replace(SOUND, status=2, errors=line), BASE).worst == "polarfield: 000.exr: every pixel is black"
    assert "should be refused" in why("black")
    for errors in ("", f"{line}\n{line}"):
        assert "without one line" in why("black", status=2, errors=errors)


def test_a_warning_that_a_case_must_give_is_asked_for():
    assert "no warning says 'explain'" in why("metal", warnings=[UNSEEN])
    assert why("metal", warnings=["the model does not explain the pictures"]) == ""


@pytest.mark.parametrize("name", whole_runs.SAME)
def test_the_base_capture_in_other_units_must_find_what_the_base_finds(name):
    assert "surface_pct 1.3, not 1" in why(name, figures={**BASE, "surface_pct": 1.3})
    assert "likeness nan, not 0.9" in why(name, figures={"surface_pct": 1.0})
    assert why("noise of 10 %", figures={**BASE, "surface_pct": 1.3}) == ""


def reflectance(change):
    case = functions.CASES[0]
    assert case.function is fresnel.normal_reflectance
    return functions._row(case, lambda eta: change(case.function(eta)), torch.float32, "float32")


def test_a_function_off_by_a_ten_thousandth_or_without_a_gradient_fails(monkeypatch):
    monkeypatch.setattr(functions, "ELEMENTS", 100)
    functions.mp.dps = functions.truths.DIGITS
    assert reflectance(lambda r: r).sound
    assert not reflectance(lambda r: 1.0001 * r).sound
    assert not reflectance(lambda r: r + 0 * torch.where(r > 0, torch.zeros_like(r), r).sqrt()).sound  # slopes of 0 / 0


def test_a_kernel_is_held_to_its_definition():
    assert fused.alike(4e-5, 4e-3, True, "lobe-12") and fused.alike(9e-3, 4e-3, True, "tree")
    assert not fused.alike(6e-5, 4e-3, True, "lobe-12") and not fused.alike(2e-2, 0.0, True, "tree")
    assert not fused.alike(0.0, 6e-3, True, "split") and not fused.alike(0.0, 0.0, False, "split")


def test_a_light_stage_fails_by_what_it_flags_good_wrongly():
    no = np.zeros(200, bool)
    two, three = no.copy(), no.copy()
    two[:2], three[:3] = True, True
    albedo = np.full((200, 3), 0.3)
    assert light_stage.faults(~no, two, albedo, two, True) == []  # 1 % of 200
    assert light_stage.faults(~no, three, albedo, no, True) == ["1.5 % of those flagged good are wrong"]
    assert light_stage.faults(~no, no, albedo, three, True) == ["3 round lobes are called anisotropic"]
    assert light_stage.faults(~no, no, albedo, no, False) == ["values that are not finite"]
    albedo[0] = 3.0
    assert light_stage.faults(~no, no, albedo, no, True) == ["a specular albedo of 3.0e+00 is flagged good"]
    assert light_stage.faults(~two, no, albedo, no, True) == light_stage.faults(no, no, albedo, no, True) == []
    off = {"n_d": [0, 6, 0, 0, 0], "n_s": [0, 0, 6, 0, 0], "sigma": [0.4, 0, 0, 0.6, 0], "rho_s": [0.4, 0, 0, 0, 0.6]}
    assert light_stage.is_wrong({k: np.array(v, float) for k, v in off.items()}).tolist() == [False, True, True, True, True]


def test_an_option_of_the_light_stage_fails_when_its_maps_relight_unlike_the_default_s():
    assert options.faults([], (1.0, 4.0), (1.0, 2.0), "ward", "ward") == []
    assert options.faults(["a.exr"], (1.0, 2.0), (1.0, 2.0), "ward", "ward") == ["a.exr not finite"]
    assert options.faults([], (0.0, 0.0), (0.0, 0.0), "ward", "ward") == ["relit black"]
    assert options.faults([], (0.4, 2.0), (1.0, 2.0), "ward", "ward") == ["relit at 0.40 of the default"]
    assert options.faults([], (1.0, 10.0), (1.0, 2.0), "ward", "ward") == ["a relit peak 5 times the default's"]
    assert options.faults([], (1.0, 2.0), (1.0, 2.0), "ward", "ggx") == ["maps.json says ward"]


def test_a_repeat_may_train_otherwise_on_one_thread_and_differ_in_nothing_else():
    first = {"train/splats.ply": "a", "masks/000.png": "b"}
    trained, masked = {**first, "train/splats.ply": "c"}, {**first, "masks/000.png": "c"}
    assert repeats.differing(first, first, "again") == ([], [])
    assert repeats.differing(first, trained, "one thread") == (["train/splats.ply"], [])
    assert repeats.differing(first, masked, "one thread")[1] == ["masks/000.png"]
    assert repeats.differing(first, trained, "again")[1] == repeats.differing(first, {}, "again")[0][1:] == ["train/splats.ply"]


def test_the_page_lists_failures_and_parts_that_were_not_run_to_their_end():
    sound = Row("functions", "a", "float32", {}, True, commit="1")
    rows = [sound, Row("kernels", "b", "far", {}, False, why="off", commit="2")]
    text = page(rows, {"machine": "m", "date": "d", "finished": {part: "1" for part in TITLES if part != "repeats"}})
    for words in ("2 cases, **1 fail**", "- kernels: b, far: off", "as a whole: the same bytes", "Commit 1.", "Commit 2."):
        assert words in text
