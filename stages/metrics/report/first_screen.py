"""What a reader wants before anything else: what it cost, what was left out, what to do next (as HTML)."""

from __future__ import annotations

import html
import shlex
from collections.abc import Mapping, Sequence
from typing import Any

from pipeline.engine.outlook import amount
from pipeline.engine.progress import clock
from pipeline.engine.stage import StageRun
from pipeline.environments import shipped_map

SHOWN = 5
STILL_GAINING_DB = 0.1
"""PSNR of the validation views that the last two hundred steps or so still added: below, twice the steps add little."""
HOLES_PCT = 0.5
FLAGGED_PCT = 20.0


def cost_lines(manifests: Mapping[str, Mapping[str, Any]]) -> list[str]:
    """Total time beside what was foretold, the dearest stages, memory."""
    wall = {name: float(m.get("wall_s") or 0.0) for name, m in manifests.items()}
    total = sum(wall.values())
    lines = [f"{clock(total)} in all, {clock(_sum(manifests, 'cpu_s') or 0.0)} of the processor"]
    foretold = _sum(manifests, "expected_wall_s"), _sum(manifests, "expected_cpu_s")
    if foretold[0] is not None and foretold[1] is not None:
        lines.append(f"foretold: {clock(foretold[0])}, {clock(foretold[1])} of the processor")
    dearest = sorted(wall, key=lambda name: -wall[name])[:3]
    lines.append(", ".join(f"{name} {clock(wall[name])} ({100 * wall[name] / max(total, 1e-9):.0f} %)" for name in dearest))
    peak = max(manifests, key=lambda name: float(manifests[name].get("peak_rss_mb") or 0.0), default=None)
    if peak is not None:
        lines.append(f"at most {float(manifests[peak].get('peak_rss_mb') or 0.0):,.0f} MB of memory ({peak})".replace(",", " "))
    disk = sum(o["bytes"] for m in manifests.values() for o in m.get("outputs", [])) / 2**20
    return [*lines, f"{disk:,.{0 if disk >= 10 else 1}f} MB on disk".replace(",", " ")]


def _sum(manifests: Mapping[str, Mapping[str, Any]], name: str) -> float | None:
    """The sum of a figure over all stages; None where one of them does not have it."""
    found = [m.get(name) for m in manifests.values()]
    known = [float(v) for v in found if isinstance(v, int | float)]
    return sum(known) if len(known) == len(found) else None


def left_out_rows(left_out: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
    """What was left out, dearest first, with what each saved; and the sum."""
    rows = [
        {"name": name.replace(".", ": "), "saved": amount(left["saved_s"], left["saved_mb"]), "reason": left["reason"]}
        for name, left in sorted(left_out.items(), key=lambda item: -item[1]["saved_s"])
    ]
    total = sum(left["saved_s"] for left in left_out.values())
    return {"rows": rows, "shown": SHOWN, "total": clock(total) if total >= 0.5 else ""}


def next_steps(run: StageRun, metrics: Mapping[str, Any], warnings: int, log: Sequence[Mapping[str, str]]) -> list[str]:
    """What is worth doing now, most pressing first."""
    capture = html.escape(shlex.quote(str(run.capture.root)))
    out = []
    if warnings:
        out.append(f"Read the warning{'s' * (warnings > 1)} below: {'they say' if warnings > 1 else 'it says'} what to check.")
    holes = metrics.get("train", {}).get("holes_pct")
    if holes is not None and holes > HOLES_PCT:
        out.append(f"{holes:.1f} % of the object is not covered: look at the test views below, and at their masks.")
    flagged = metrics.get("olat", {}).get("flagged_pct")
    if flagged is not None and flagged > FLAGGED_PCT:
        out.append(f"{flagged:.0f} % of the pixels are flagged: the flag maps below say why, the report's warnings what to do.")
    if (gain := still_gaining(log)) is not None:
        steps = 2 * int(float(log[-1]["iteration"]))
        out.append(
            f"Training was still gaining ({gain:.2f} dB in its last steps): <code>make all CAPTURE={capture} "
            f"PARAMS=train.iterations={steps}</code> should gain more."
        )
    if _no_truth(metrics):
        out.append("The capture has no ground truth: held-back views are the only judge, so look at them below.")
    maps = run.capture.environments
    if "relight" in run.inputs and maps and all(path == shipped_map(path.stem) for path in maps):
        out.append(f"Light it with maps of your own: <code>make relight CAPTURE={capture} ENVS=map.hdr</code>.")
    if (run.inputs.get("mesh") or run.output).joinpath("asset").is_dir():
        out.append("Open <code>mesh/current/asset/</code> in another program: glTF, USD, OBJ, MaterialX, Mitsuba, Blender.")
    if "train" in run.inputs or "olat" in run.inputs:
        out.append(f"<code>make tradeoff CAPTURE={capture}</code> finds what half the time costs, and what more time buys.")
    return out


def still_gaining(log: Sequence[Mapping[str, str]]) -> float | None:
    """dB that the validation views gained between the last two rows of a training log; None where that is little or unknown."""
    if len(log) < 3:
        return None
    try:
        last, before = (float(row["psnr_validation"]) for row in (log[-1], log[-3]))
    except (KeyError, TypeError, ValueError):
        return None
    gain = last - before
    return gain if gain > STILL_GAINING_DB else None


def _no_truth(metrics: Mapping[str, Any]) -> bool:
    """Whether a trained model has neither true normals nor a true mesh to be held against."""
    train, mesh = metrics.get("train") or {}, metrics.get("mesh") or {}
    return bool(train) and train.get("normal_mae_deg") is None and mesh.get("chamfer_pct") is None
