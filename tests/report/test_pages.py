"""Pages are whole files: no links out, text escaped, sensible curves and scales."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from pipeline.capture import Capture
from pipeline.geometry.axes import nearest_to_lines
from pipeline.geometry.cameras import Camera, camera_from_opengl
from pipeline.report import pictures
from pipeline.report.curves import line_chart, nice_ticks
from pipeline.report.inspect import scene_of
from pipeline.report.render import render
from pipeline.rig.map_flags import FLAGS as OLAT_FLAGS
from stages.metrics import report
from stages.metrics.report import rig_pictures
from stages.metrics.report.figures import headlines, tables, text_of
from stages.metrics.report.first_screen import cost_lines, left_out_rows, still_gaining
from stages.metrics.report.page import cost_rows, offset_fact, training_curves, training_log
from stages.metrics.report.viewer import page as viewer_page
from synth.orbit import look_at, orbit

REPORT = Path(report.__file__).parent


def context(**changes):
    base = {
        "text_of": text_of, "name": "a <b>capture</b>", "facts": ["16 views"], "tiles": [], "plan": [], "views": [],
        "environment": [], "relit": [], "olat": [], "lobe": {}, "curves": [],
        "costs": cost_rows({"train": {"wall_s": 71.0, "peak_rss_mb": 1200, "outputs": []}}),
        "tables": [], "warnings": [("decode", "<script>alert(1)</script>")], "parameters": {}, "packages": {},
        "next": [], "spent": [], "left_out": left_out_rows({}), "disagreement": [], "scene": None, "scene_text": "null",
        "script": viewer_page.script(), "viewer_style": viewer_page.style(),
    }  # fmt: skip
    return {**base, **changes}


def test_report_links_to_nothing_and_escapes_text():
    metrics = {"train": {"psnr_srgb": None, "why": {"psnr_srgb": "no truth <here>"}, "wall_s": 1.0}}
    page = render("report.html.jinja", context(tables=tables(metrics), tiles=headlines({"mesh": {"chamfer_pct": 0.3}})), REPORT)
    assert "<script>alert" not in page
    assert "a <b>" not in page
    assert "no truth &lt;here&gt;" in page
    assert "0.300" in page
    assert not re.findall(r"(?:src|href)=[\"']?(?:https?:)?//", page)
    assert "1 min 11 s" in page


def test_what_was_left_out_stands_dearest_first_with_what_it_saved():
    left = {
        "olat": {"saved_s": 4.0, "saved_mb": 160.0, "reason": "no frames <of lights>"},
        "train.concavities": {"saved_s": 90.0, "saved_mb": 0.0, "reason": "only full Stokes is evidence enough"},
    }
    page = render("report.html.jinja", context(left_out=left_out_rows(left)), REPORT)
    assert page.index("train: concavities") < page.index("<b>olat</b>") and "about 1 min 30 s" in page
    assert "about 4.0 s, 160 MB" in page and "1 min 34 s saved" in page and "&lt;of lights&gt;" in page


def test_cost_is_told_beside_what_was_foretold_only_where_all_of_it_was():
    made = {
        "train": {"wall_s": 90.0, "cpu_s": 80.0, "expected_wall_s": 100.0, "expected_cpu_s": 110.0, "peak_rss_mb": 700.0},
        "mesh": {"wall_s": 10.0, "cpu_s": 8.0},
    }
    assert cost_lines(made)[0] == "1 min 40 s in all, 1 min 28 s of the processor"
    assert cost_lines(made)[1].startswith("train 1 min 30 s (90 %)")
    made["mesh"] |= {"expected_wall_s": 20.0, "expected_cpu_s": 15.0}
    assert cost_lines(made)[1] == "foretold: 2 min 00 s, 2 min 05 s of the processor"


def test_training_counts_as_gaining_only_while_it_does():
    rising = [{"psnr_validation": str(v)} for v in (30.0, 31.0, 31.5)]
    assert still_gaining(rising) == pytest.approx(1.5)
    assert still_gaining([*rising, *[{"psnr_validation": "31.52"}] * 2]) is None
    assert still_gaining([{"psnr_validation": ""}] * 4) is None and still_gaining([]) is None


def test_pictures_are_data_and_never_enlarged():
    small = np.zeros((10, 20, 3), np.uint8)
    assert pictures.data_uri(small).startswith("data:image/png;base64,")
    assert pictures.fit(small, 400).shape == (10, 20, 3)
    assert pictures.fit(np.zeros((100, 200, 3), np.uint8), 50).shape == (25, 50, 3)


def test_colours_of_angles_wrap_at_180_degrees():
    full = np.ones((1, 1))
    near, far = (pictures.angles(np.full((1, 1), a), full) for a in (np.pi / 2 - 1e-3, -np.pi / 2 + 1e-3))
    assert np.abs(near.astype(int) - far).max() <= 1
    across = pictures.angles(np.zeros((1, 1)), full)
    assert np.abs(near.astype(int) - across).max() > 100


def test_numbers_outside_a_scale_take_its_ends():
    colours = pictures.scale(np.array([[-1.0, 0.0, 1.0, 9.0, np.nan]]), 0, 1)
    assert np.array_equal(colours[0, 0], colours[0, 1])
    assert np.array_equal(colours[0, 2], colours[0, 3])
    assert np.array_equal(colours[0, 4], colours[0, 0])


@pytest.mark.parametrize(("low", "high"), [(0, 1), (17.3, 31.9), (0, 4821), (-3, 3), (1e-6, 5e-6)])
def test_ticks_are_few_and_inside(low, high):
    ticks = nice_ticks(low, high)
    assert 2 <= len(ticks) <= 8
    assert low - 1e-9 <= ticks[0] <= ticks[-1] <= high + 1e-9 * high


def test_curves_break_where_a_value_is_missing():
    chart = line_chart([0, 1, 2, 3], {"psnr": [1, 2, float("nan"), 4]}, "wall time (s)", "PSNR (dB)")
    assert chart.count("<polyline") == 2
    assert line_chart([0], {"psnr": [1]}, "x", "y") == ""
    assert line_chart([0, 1], {"psnr": [float("nan")] * 2}, "x", "y") == ""


def test_a_level_curve_has_one_tick_at_its_value():
    chart = line_chart([0, 1], {"Gaussians": [18183, 18183]}, "wall time (s)", "Number of Gaussians")
    assert chart.count('class="grid"') == 1 and ">18183</text>" in chart


def test_flags_of_a_light_stage_are_named_with_their_shares():
    assert [meaning for _, _, meaning in rig_pictures.FLAGS] == list(OLAT_FLAGS)
    assert rig_pictures.flag_legend(np.array([0, 0, 0, 7])) == "teal peak outside the lights (25.0 %)"
    assert rig_pictures.flag_legend(np.zeros(0, int)) == rig_pictures.flag_legend(np.zeros(3, int)) == "none"


def test_maps_are_shown_with_the_lobe_that_was_fitted():
    lobe = {"lobe": "ggx", "sigma": "GGX widths (alpha)"}
    olat = [{"view": "cam00", "figures": {}, "pictures": []}]
    assert "the lobe is ggx, σ its two GGX widths (alpha)" in render("report.html.jinja", context(olat=olat, lobe=lobe), REPORT)


def test_an_offset_of_the_world_is_told_to_its_last_digit():
    offset = {"poses": {"facts": {"world_offset": [4321987.125, 0.0, -12.0]}}}
    assert offset_fact(offset) == ["positions in its files are relative to (4321987.125, 0, -12)"]
    assert offset_fact({"poses": {"facts": {}}}) == offset_fact({}) == []


def test_training_log_becomes_charts(tmp_path):
    log = tmp_path / "train_log.csv"
    log.write_text(
        "iteration,wall_s,psnr_validation,rgb,splats\n100,1.0,20.5,0.1,500\n200,2.0,,0.05,900\n300,3.5,24,0.02,950\n"
    )
    assert len(training_curves(training_log(log))) == 3
    log.write_text("iteration,wall_s\n")
    assert training_curves(training_log(log)) == training_log(tmp_path / "none.csv") == []


def test_units_follow_the_name():
    assert text_of("normal_mae_deg", 5.128) == "5.13°"
    assert text_of("albedo_rel_median", 0.0065) == "0.65 %"
    assert text_of("psnr_srgb", 31) == "31.00 dB"
    assert text_of("polariser_error_deg", {"camA": 0.5, "camB": None}) == "camA 0.50°, camB –"
    assert text_of("something_new_pct", 2) == "2.00 %"


def test_viewing_axes_meet_at_the_object():
    target = np.array([3.0, -1.0, 2.0])
    cameras = [
        Camera(8, 8, 9.0, 9.0, 4.0, 4.0, camera_from_opengl(look_at(target + p, target))) for p in orbit(7, 4.0, -10, 50)
    ]
    centres = np.stack([c.centre for c in cameras])
    axes = np.stack([c.world_to_camera[2, :3] for c in cameras])
    assert nearest_to_lines(centres, axes) == pytest.approx(target, abs=1e-9)


def test_cameras_that_all_look_one_way_are_drawn_about_their_middle():
    cameras = {}
    for k in range(3):
        pose = np.eye(4)
        pose[0, 3] = -2.0 * k
        cameras[f"v{k}"] = Camera(8, 8, 9.0, 9.0, 4.0, 4.0, pose)
    drawn = scene_of(Capture(Path("row"), "numbers", "multiview", "none", cameras=cameras))
    assert [c["at"] for c in drawn["cameras"]] == [[-1, 0, 0], [0, 0, 0], [1, 0, 0]]
    assert [c["test"] for c in drawn["cameras"]] == [True, False, False]
