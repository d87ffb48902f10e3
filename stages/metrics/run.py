"""The metrics stage's steps: a table per stage, metrics.json, report.html."""

from __future__ import annotations

import json
from typing import Any

from pipeline.engine.stage import StageRun
from pipeline.formats import dataset_files as files
from pipeline.geometry.lens import FRAMES, frames_folder

from .mesh_figures import mesh_table
from .olat_figures import olat_table
from .relight_figures import light_stage_table, relight_table
from .table import Table
from .train_figures import train_table

COSTS = ("wall_s", "cpu_s", "peak_rss_mb")
LEFT_OUT = "left_out"
"""Of metrics.json: what the plan left out, by STAGE or STAGE.PASS, with what that saved."""


def measure(run: StageRun) -> None:
    """Write metrics.json and report.html."""
    manifests = {name: json.loads((folder / files.MANIFEST).read_text()) for name, folder in run.inputs.items()}
    tables = figures(run)
    out: dict[str, Any] = {"schema": 1}
    for name, manifest in manifests.items():
        costs = {k: manifest.get(k) for k in COSTS}
        out[name] = {**tables.get(name, Table()).as_json(), **costs}
    out[LEFT_OUT] = {name: dict(left) for name, left in run.left_out.items()}
    (run.output / "metrics.json").write_text(json.dumps(out, indent=1) + "\n")
    from .report.page import write_report

    write_report(run, out, manifests)


def figures(run: StageRun) -> dict[str, Table]:
    """A table for every stage that ran and has figures beside its costs."""
    inputs, capture = run.inputs, run.capture
    truth = capture.truth
    masks = inputs.get("masks")
    tables: dict[str, Table] = {}
    steps = [name for name in ("decode", "masks", "olat", "train", "mesh", "relight") if name in inputs]
    with run.progress.bar("measuring", total=len(steps), unit="stages") as bar:
        for name in steps:
            if name == "decode":
                tables[name] = _decode_table(run)
            elif name == "masks":
                tables[name] = _masks_table(run)
            elif name == "olat":
                tables[name] = olat_table(inputs["olat"], truth)
            elif name == "train":
                decode = frames_folder(inputs)
                frames = json.loads((decode / FRAMES).read_text())
                tables[name] = train_table(inputs["train"], decode, masks, truth, frames)
                for line in tables[name].doubts:
                    run.warn(line)
                _say_near_light(run)
            elif name == "mesh":
                tables[name] = mesh_table(inputs["mesh"], truth.mesh, run.parameters.mesh_samples, capture.config.unit_m)
            elif capture.kind == "light_stage":
                tables[name] = light_stage_table(inputs["relight"], masks)
            else:
                tables[name] = relight_table(inputs["relight"], masks, truth)
            bar.advance(1)
    return tables


def _say_near_light(run: StageRun) -> None:
    """A line where the highlights point at a lamp inside the scene."""
    from .near_light import near_light

    found, line = near_light(run.inputs)
    run.note("near_light", [{"q": round(c.q, 3), "error": round(c.error, 3), "highlights": c.count} for c in found])
    if line is not None:
        run.warn(f"{run.capture.root}: {line}")


def _decode_table(run: StageRun) -> Table:
    """What decode found of each view."""
    table = Table()
    path = run.inputs["decode"] / FRAMES
    if path.exists():
        for view, facts in sorted(json.loads(path.read_text()).get("views", {}).items()):
            row = {k: facts.get(k) for k in ("saturated_fraction", "noise", "condition") if facts.get(k) is not None}
            table.rows.append({"view": view, **row})
        table.means(["saturated_fraction"])
    return table


def _masks_table(run: StageRun) -> Table:
    """Coverage of each mask."""
    table = Table()
    path = run.inputs["masks"] / files.MASKS
    if path.exists():
        for view, facts in sorted(json.loads(path.read_text()).get("views", {}).items()):
            if isinstance(facts, dict) and "coverage" in facts:
                table.rows.append({"view": view, "coverage": facts["coverage"]})
        table.means(["coverage"])
    return table
