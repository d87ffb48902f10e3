"""A report on a telephone: nothing reaches over the edge, so nobody scrolls sideways."""

from __future__ import annotations

import html
import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from pipeline.report.pictures import picture
from pipeline.report.render import render
from stages.metrics import report
from stages.metrics.report.figures import tables
from stages.metrics.report.first_screen import left_out_rows
from stages.metrics.report.page import cost_rows
from stages.metrics.report.viewer import page as viewer_page

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
WIDTHS = (390, 320)


def whole_report() -> str:
    """A report with a picture in every place that has one, and long words."""
    here = [
        picture(np.zeros((96, 64, 3), np.uint8), "normals", "of a_view_with_a_long_name", 132, p) for p in ("", "first", "")
    ]
    wide = picture(np.zeros((64, 128, 3), np.uint8), "map", "the light", 560)
    cards = [{"view": "000", "figures": {"psnr_srgb": 30.0}, "pictures": here}]
    context = {
        "text_of": lambda name, value: f"{value}", "name": "a_capture_whose_name_is_long", "facts": ["16 views"], "tiles": [],
        "plan": [{"name": "train", "run": True, "reason": "x", "passes": {}}], "views": cards, "environment": [wide, wide],
        "relit": [{"name": "studio", "figures": {}, "map": wide, "pictures": here}], "olat": cards,
        "lobe": {"lobe": "ggx", "sigma": "widths"},
        "curves": ["<figure><svg class=chart viewBox='0 0 380 200'></svg></figure>"], "disagreement": cards, "warnings": [],
        "costs": cost_rows({"train": {"wall_s": 71.0, "peak_rss_mb": 1200, "outputs": [], "key": "0123456789abcdef"}}),
        "tables": tables({"train": {"psnr_srgb": 30.0, "views": [{"view": "000", "psnr_srgb": 30.0}]}}),
        "parameters": {"train": {"a_parameter_with_a_long_name": "x" * 80}}, "packages": {"numpy": "2"},
        "next": ["<code>make all</code>"],
        "spent": ["1 min"], "left_out": left_out_rows({}), "scene": None, "scene_text": "null", "script": viewer_page.script(),
        "viewer_style": viewer_page.style(),
    }  # fmt: skip
    return render("report.html.jinja", context, Path(report.__file__).parent)


@pytest.mark.slow
@pytest.mark.skipif(CHROMIUM is None, reason="no Chromium to lay the page out")
def test_no_part_of_a_report_reaches_over_the_edge_of_a_small_screen(tmp_path):
    inner = html.escape(whole_report(), quote=True)
    frames = "".join(f'<iframe style="width:{w}px;height:700px" srcdoc="{inner}"></iframe>' for w in WIDTHS)
    measure = (
        "onload = () => { const out = [...document.querySelectorAll('iframe')].map(f => f.contentDocument.documentElement)"
        ".map(d => { d.querySelectorAll('details').forEach(x => { x.open = true; }); "
        "return `${d.scrollWidth}/${d.clientWidth}`; });"
        " document.body.innerHTML = `WIDTHS ${out.join(' ')} END`; };"
    )
    page = tmp_path / "frames.html"
    page.write_text(f"<!doctype html><meta charset=utf-8>{frames}<script>{measure}</script>", encoding="utf-8")
    options = ["--headless", "--no-sandbox", "--no-first-run", "--disable-gpu", f"--user-data-dir={tmp_path / 'profile'}"]
    command = [str(CHROMIUM), *options, "--virtual-time-budget=20000", "--dump-dom", f"file://{page}"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)
    found = re.search(r"WIDTHS (\S+) (\S+) END", done.stdout)
    assert found, done.stderr[-400:]
    for pair in found.groups():
        needed, given = map(int, pair.split("/"))
        assert given > 250
        assert needed <= given
