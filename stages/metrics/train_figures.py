"""The trained model against its test views and the true normals, material, environment and polarisers."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.formats.images import read_exr, read_image, read_stokes

from .environment_figures import environment_figures
from .image_figures import erode, normal_figures, polarisation_figures, radiance_figures
from .table import Table
from .truth import RGB, Truth, read_target

NORMALS = ("normal_mae_deg", "normal_cosine_distance")
RADIANCE = ("psnr_srgb", "psnr_foreground", "ssim")
POLARISATION = ("dolp_mae", "aolp_mae_deg")
ENVIRONMENT = ("env_psnr", "env_psnr_scaled", "env_log_correlation")


def train_table(train: Path, decode: Path, masks: Path | None, truth: Truth, frames: dict[str, Any]) -> Table:
    """Figures of every test view, their means, and those of the whole model."""
    table = Table()
    tests = sorted(p.stem for p in (train / "test").glob("*.exr"))
    angles = json.loads((train / "polarisers.json").read_text()) if (train / "polarisers.json").exists() else {}
    for view in tests:
        table.rows.append({"view": view, **_view_figures(train, decode, masks, truth, view, frames, angles)})
    table.figures["views"] = len(tests)
    table.means()
    table.missing(NORMALS, "the capture has no gt/normal")
    behind = frames.get("polarisation") == "polarisers"
    table.missing(RADIANCE, "the views were taken behind polarisers: s0 is not measured" if behind else "no test view")
    table.missing(POLARISATION, "the capture holds no Stokes vectors of its views")
    _material(table, truth)
    _environment(table, train, truth)
    _polarisers(table, angles, truth)
    return table


def _view_figures(
    train: Path, decode: Path, masks: Path | None, truth: Truth, view: str, frames: dict[str, Any], angles: dict[str, Any]
) -> dict[str, float]:
    path = train / "test" / f"{view}.exr"
    stokes, channels = read_stokes(path), read_exr(path)
    normal = np.stack([channels[f"N.{c}"] for c in "XYZ"], -1)
    target, true_normal = read_target(decode, masks, view), truth.normal(view)
    inside = target.inside
    if target.stokes is None and true_normal is not None:
        inside = erode(np.linalg.norm(true_normal, axis=-1) > 0.5, 1)
    elif inside is None:
        inside = channels["alpha"] > 0.5
    if not inside.any():
        return {}
    out = {"ior_mean": float(channels["ior"][inside].mean()), "roughness_mean": float(channels["roughness"][inside].mean())}
    if true_normal is not None and true_normal.shape == normal.shape:
        out |= normal_figures(normal, true_normal, inside)
    if target.rgb.shape != stokes[:, :, 0].shape:
        return out
    stokes = stokes * target.compared[..., None, None]
    if target.stokes is not None:
        out |= radiance_figures(stokes[:, :, 0], target.stokes[:, :, 0], inside)
        out |= polarisation_figures(stokes, target.stokes, inside)
    elif frames.get("polarisation") == "polarisers":
        angle = angles.get(frames.get("views", {}).get(view, {}).get("camera", ""), {}).get("angle_deg")
        if angle is not None:
            t = 2 * np.radians(angle)
            seen = 0.5 * (stokes[:, :, 0] + stokes[:, :, 1] * np.cos(t) + stokes[:, :, 2] * np.sin(t))
            figures = radiance_figures(seen, target.rgb, inside)
            out |= {f"{name}_behind_polariser": value for name, value in figures.items()}
    else:
        out |= radiance_figures(stokes[:, :, 0], target.rgb, inside)
    return out


def _material(table: Table, truth: Truth) -> None:
    material = truth.document("material.json") or {}
    for name, value in (("ior", material.get("ior")), ("roughness", material.get("alpha"))):
        mean = table.figures.get(f"{name}_mean")
        if value is not None and mean is not None:
            true = float(value) ** 0.5 if name == "roughness" else float(value)  # alpha = r^2
            table.figures[f"{name}_error"] = abs(mean - true)
        table.missing([f"{name}_error"], "the capture has no gt/material.json that tells it")


def _environment(table: Table, train: Path, truth: Truth) -> None:
    path = truth.root / "gt" / "env.hdr"
    if path.is_file() and (train / "env.exr").is_file():
        table.figures |= environment_figures(read_image(train / "env.exr", RGB), read_image(path, RGB))
    table.missing(ENVIRONMENT, "the capture has no gt/env.hdr")


def _polarisers(table: Table, fitted: dict[str, Any], truth: Truth) -> None:
    true = truth.polarisers()
    if true is None:
        if fitted:
            table.missing(["polariser_error_deg"], "the capture has no gt/polarisers.json")
        return
    errors = {}
    for name, angle in true.items():
        known = fitted.get(name, {}).get("angle_deg")
        errors[name] = None if known is None else abs((known - angle + 90) % 180 - 90)
    table.figures["polariser_error_deg"] = errors
    unknown = [name for name, e in errors.items() if e is None]
    if unknown:
        table.why["polariser_error_deg"] = f"no angle was fitted for {', '.join(unknown)}"
