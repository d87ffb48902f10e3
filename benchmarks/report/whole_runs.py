"""What the page says of whole runs of the program: the papers' own settings, and what other programs make of an asset."""

from __future__ import annotations

from typing import Any

from benchmarks.report.scatter import Point
from benchmarks.report.section import Section, number


def ablation(stored: dict[str, Any]) -> Section:
    """PhyGaP's ablation and its weights, and this program beside them."""
    rows = [["capture", "run", "steps", "processor time, s", "relit PSNR, dB", "SSIM", "environment, dB", "normals, degrees"]]
    points = []
    for capture, runs in stored["captures"].items():
        for name, run in runs.items():
            relit, views, light = run["relit"], run["views"], run["environment"]
            figures = (run["processor_s"], relit["psnr_srgb"], relit["ssim"], light["env_psnr"], views["normal_mae_deg"])
            rows.append([capture, name, str(run["parameters"]["iterations"]), *(number(f) for f in figures)])
            points.append(Point(capture, name, run["processor_s"], views["normal_mae_deg"], name == "ours"))
    since = sorted({row for row, changes in stored.get("defaults_since", {}).items() if changes})
    text = (
        "PhyGaP's Table 2 (with its losses, its shading and its GridMap), the sweep of its weights where it has been run, and "
        "this program's defaults beside it, from photographs to relit views. As in the paper, no polarisation is a weight of 0."
    )
    if since:
        text += f" Made with other defaults than today's: {', '.join(since)}."
    plots = [("ablation", points, "processor seconds", "normals, mean error (degrees)")]
    return Section("The paper's own runs", text, rows, plots)


def assets(stored: dict[str, Any]) -> Section:
    """An asset opened by other programs."""
    heads = ["as rendered, dB", "without its noise, dB", "against truth, dB", "ours against truth, dB"]
    rows = [["capture, program and file", *heads, "mean radiance beside ours, R G B", "samples", "s a view"]]
    for name, row in stored.items():
        ratio = " ".join(f"{x:.3f}" for x in row["mean_ratio"])
        levels = [row.get(key) for key in ("psnr_foreground", "psnr_noiseless", "psnr_truth", "psnr_truth_ours")]
        figures = ["" if level is None else number(level) for level in levels]
        rows.append([name, *figures, ratio, str(row["samples"] or ""), number(row["seconds"])])
    text = (
        "The asset of a whole run, lit by a map that training did not see: PSNR of the object against our own relit view of it, "
        "and both against path-traced truth. Noise is taken out by two renderings with samples of their own."
    )
    return Section("Assets in other programs", text, rows)
