"""report.html: what the capture was, what was done and why, pictures, curves, figures, costs; one file without links."""

from __future__ import annotations

import csv
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pipeline.engine.dataset import Dataset
from pipeline.engine.outlook import amount
from pipeline.engine.progress import brief, clock
from pipeline.engine.stage import StageRun
from pipeline.formats.dataset_files import FITTED_LOBE, TRAIN_LOG
from pipeline.report.curves import line_chart
from pipeline.report.render import render

from .figures import headlines, tables, text_of
from .first_screen import cost_lines, left_out_rows, next_steps
from .viewer import page
from .viewer.model_scene import model_scene
from .viewer.rig_scene import rig_scene

FOLDER = Path(__file__).parent


def write_report(run: StageRun, metrics: dict[str, Any], manifests: Mapping[str, dict[str, Any]]) -> None:
    """Write report.html into the stage's output."""
    scene = model_scene(run) or rig_scene(run)
    log = training_log(run.inputs["train"] / TRAIN_LOG) if "train" in run.inputs else []
    warnings = [(n, w) for n, m in manifests.items() for w in m.get("warnings", [])]
    warnings += [("capture", w) for w in run.capture.warnings]
    context = {
        "text_of": text_of,
        "name": run.capture.root.name,
        "facts": capture_facts(run) + offset_fact(manifests),
        "tiles": headlines(metrics),
        "plan": plan_rows(run, manifests),
        "views": [], "environment": [], "relit": [], "olat": [], "lobe": {}, "disagreement": [],
        "scene": scene, "scene_text": page.embedded(scene), "script": page.script(), "viewer_style": page.style(),
        "curves": training_curves(log),
        "spent": cost_lines(manifests), "left_out": left_out_rows(run.left_out),
        "next": next_steps(run, metrics, len(warnings), log),
        "costs": cost_rows(manifests),
        "tables": tables(metrics),
        "warnings": warnings,
        "parameters": {n: m.get("parameters", {}) for n, m in manifests.items() if m.get("parameters")},
        "packages": dict(sorted({k: v for m in manifests.values() for k, v in m.get("packages", {}).items()}.items())),
    }  # fmt: skip
    if "train" in run.inputs:
        from . import model_pictures

        context["views"] = model_pictures.view_cards(run, metrics)
        context["environment"] = model_pictures.environment_pictures(run)
        context["relit"] = model_pictures.relit_cards(run, metrics) if "relight" in run.inputs else []
    if "olat" in run.inputs:
        from . import rig_pictures

        context["lobe"] = json.loads((run.inputs["olat"] / FITTED_LOBE).read_text())
        context["olat"] = rig_pictures.olat_cards(run, metrics)
        context["disagreement"] = rig_pictures.disagreement_cards(run)
        if run.capture.kind == "light_stage" and "relight" in run.inputs:
            context["relit"] = rig_pictures.relit_cards(run)
    (run.output / "report.html").write_text(render("report.html.jinja", context, FOLDER), encoding="utf-8")


PASSES = {
    "both": "cross and parallel polarised", "cross": "behind crossed polarisers alone",
    "parallel": "behind parallel polarisers alone",
    "none": "without polarisers",
}  # fmt: skip


def capture_facts(run: StageRun) -> list[str]:
    """What the capture was, in a few words each."""
    c = run.capture
    if c.light_stage is not None:
        cameras = list(c.light_stage.cameras.values())
        size = f"{cameras[0].camera.width} × {cameras[0].camera.height} px"
        count = len(cameras)
        return [
            c.layout.replace("_", " "),
            f"{len(c.light_stage.lights)} lights",
            f"{count} camera{'s' if count > 1 else ''}",
            size,
            PASSES[cameras[0].passes],
        ]
    words = {"stokes": "full linear Stokes vectors", "polarisers": "behind polarisers", "none": "no polarisation data"}
    size = next((f"{v.size[0]} × {v.size[1]} px" for v in c.views if v.size), "")
    facts = [c.layout.replace("_", " "), f"{len(c.views)} views", size, words[c.polarisation], f"{c.up} up", *c.facts]
    return [f for f in facts if f]


def offset_fact(manifests: Mapping[str, dict[str, Any]]) -> list[str]:
    """What positions in the dataset's files are relative to, where that is not the capture's own origin."""
    offset = manifests.get("poses", {}).get("facts", {}).get("world_offset")
    return [f"positions in its files are relative to ({', '.join(f'{x:.12g}' for x in offset)})"] if offset else []


def plan_rows(run: StageRun, manifests: Mapping[str, dict[str, Any]]) -> list[dict[str, Any]]:
    """Every stage's decision with its reason; passes that stages decided on while running are added."""
    plan = Dataset.holding(next(iter(run.inputs.values()))).read_description().get("plan") if run.inputs else None
    if plan is None:
        plan = {n: m.get("decision", {"run": True, "reason": ""}) for n, m in manifests.items()}
    rows = []
    for name, decision in plan.items():
        passes = dict(decision.get("passes", {}))
        facts = manifests.get(name, {}).get("facts", {})
        passes |= {k: v for k, v in facts.items() if isinstance(v, dict) and {"run", "reason"} <= set(v)}
        left = {part: saved(run, f"{name}.{part}" if part else name) for part in ("", *passes)}
        rows.append({"name": name, "run": decision["run"], "reason": decision["reason"], "passes": passes, "saved": left})
    return rows


def saved(run: StageRun, name: str) -> str:
    """What leaving a stage or pass out saved, to put behind its reason."""
    left = run.left_out.get(name)
    return f" (saved {amount(left['saved_s'], left['saved_mb'])})" if left else ""


def cost_rows(manifests: Mapping[str, dict[str, Any]]) -> dict[str, Any]:
    """Wall time, processor time, memory and disk of each stage, and the totals."""
    walls = [float(m.get("wall_s") or 0) for m in manifests.values()]
    longest = max([*walls, 1e-9])
    rows = []
    for (name, m), wall in zip(manifests.items(), walls):
        foretold = m.get("expected_wall_s")
        disk = sum(o["bytes"] for o in m.get("outputs", [])) / 2**20
        rows.append({
            "name": name, "wall": clock(wall) if wall >= 10 else f"{wall:.1f} s", "cpu": f"{float(m.get('cpu_s') or 0):.1f} s",
            "foretold": brief(foretold) if isinstance(foretold, int | float) else "",
            "memory": f"{float(m.get('peak_rss_mb') or 0):,.0f} MB".replace(",", " "), "disk": f"{disk:.1f} MB",
            "share": 100 * wall / longest, "key": m.get("key", ""), "device": m.get("device", ""),
        })  # fmt: skip
    peak = max([float(m.get("peak_rss_mb") or 0) for m in manifests.values()] or [0])
    return {"rows": rows, "wall": clock(sum(walls)), "memory": f"{peak:,.0f} MB".replace(",", " ")}


def training_log(path: Path) -> list[dict[str, str]]:
    """The rows of a training log; none where there is none."""
    if not path.is_file():
        return []
    with path.open() as stream:
        return list(csv.DictReader(stream))


def training_curves(rows: list[dict[str, str]]) -> list[str]:
    """Charts of the training log: validation PSNR and losses over wall seconds."""
    if len(rows) < 2:
        return []

    def column(name: str) -> list[float]:
        return [float(row.get(name) or "nan") for row in rows]

    wall = column("wall_s")
    losses = [n for n in rows[0] if n not in ("iteration", "wall_s", "splats") and "psnr" not in n]
    gain = [n for n in rows[0] if "psnr" in n]
    charts = [
        line_chart(wall, {n.replace("_", " "): column(n) for n in gain}, "wall time (s)", "Validation PSNR (dB)"),
        line_chart(wall, {n.replace("_", " "): column(n) for n in losses}, "wall time (s)", "Losses (logarithmic)", log=True),
        line_chart(wall, {"Gaussians": column("splats")}, "wall time (s)", "Number of Gaussians")
        if "splats" in rows[0]
        else "",
    ]
    return [c for c in charts if c]
