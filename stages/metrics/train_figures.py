"""The trained model against its test views and the true normals, material, environment and polarisers."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.formats import dataset_files as files
from pipeline.formats.gbuffer import surface_of
from pipeline.formats.ground_truth import Truth
from pipeline.formats.images import RGB, read_exr, read_image, read_stokes, srgb_encode
from pipeline.report.explained import Explained, doubts, explained

from .environment_figures import environment_figures
from .image_figures import displayable, erode, normal_figures, polarisation_figures, radiance_figures
from .lpips_distance import lpips
from .lpips_distance import missing as lpips_missing
from .material_figures import MAPS, holes_pct, material_figures
from .part_figures import FIGURES as PART_FIGURES
from .part_figures import part_figures
from .table import Table
from .targets import read_target

NORMALS = ("normal_mae_deg", "normal_cosine_distance")
RADIANCE = ("psnr_srgb", "psnr_foreground", "ssim")
UNSEEN = "the object's radiance lies outside what they look at, 0 to 1: [stokes] scale in capture.toml brings it there"
POLARISATION = ("dolp_mae", "aolp_mae_deg")
ENVIRONMENT = ("env_psnr", "env_psnr_scaled", "env_log_correlation")


def train_table(train: Path, decode: Path, masks: Path | None, truth: Truth, frames: dict[str, Any]) -> Table:
    """Figures of every test view, their means, and those of the whole model."""
    table = Table()
    tests = files.held_back_views(train)
    polarisers = train / files.POLARISERS
    angles = json.loads(polarisers.read_text()) if polarisers.exists() else {}
    for view in tests:
        table.rows.append({"view": view, **_view_figures(train, decode, masks, truth, view, frames, angles)})
    of_views = {
        row["view"]: Explained(row.get("likeness"), row.get("off"), row.get("polarisation_unexplained")) for row in table.rows
    }
    table.doubts = doubts(of_views)
    table.figures["views"] = len(tests)
    table.means()
    table.missing(NORMALS, "the capture has no gt/normal")
    behind = frames.get("polarisation") == "polarisers"
    unseen = UNSEEN if tests else "no test view"
    table.missing(RADIANCE, "the views were taken behind polarisers: s0 is not measured" if behind else unseen)
    table.missing(MAPS, "the capture has no gt/material/VIEW.exr")
    table.missing(PART_FIGURES, "no gt/material/VIEW.exr holds that part (diffuse.R ..., specular.R ...)")
    if not behind:
        table.missing(["lpips"], lpips_missing() or "the views are smaller than its network takes")
    table.missing(POLARISATION, "the capture holds no Stokes vectors of its views")
    _material(table, truth)
    _environment(table, train, truth)
    _polarisers(table, angles, truth)
    return table


def _view_figures(
    train: Path, decode: Path, masks: Path | None, truth: Truth, view: str, frames: dict[str, Any], angles: dict[str, Any]
) -> dict[str, float]:
    path = files.held_back_image(train, view)
    channels = read_exr(path)
    stokes, surface = read_stokes(path), surface_of(channels)
    normal = surface.normal
    target, true_normal = read_target(decode, masks, view), truth.normal(view)
    inside = target.inside
    if target.stokes is None and true_normal is not None:
        inside = erode(np.linalg.norm(true_normal, axis=-1) > 0.5, 1)
    elif inside is None:
        inside = surface.alpha > 0.5
    if not inside.any():
        return {}
    out = {"ior_mean": float(surface.ior[inside].mean()), "roughness_mean": float(surface.roughness[inside].mean())}
    out["holes_pct"] = holes_pct(surface.alpha, inside)
    true_material = truth.find("material", view)
    if true_material is not None:
        out |= material_figures(true_material, surface, inside) | part_figures(true_material, channels, inside)
    if true_normal is not None and true_normal.shape == normal.shape:
        out |= normal_figures(normal, true_normal, inside)
    if target.rgb.shape != stokes[:, :, 0].shape:
        return out
    stokes = stokes * target.compared[..., None, None]
    facts = frames.get("views", {}).get(view, {})
    seen, polarised, suffix = stokes[:, :, 0], None, ""
    if target.stokes is not None:
        polarised = (stokes[inside][:, 1:], target.stokes[inside][:, 1:])
        out |= polarisation_figures(stokes, target.stokes, inside)
    elif frames.get("polarisation") == "polarisers":
        angle = angles.get(facts.get("camera", ""), {}).get("angle_deg")
        if angle is None:
            return out
        t = 2 * np.radians(angle)
        seen, suffix = 0.5 * (seen + stokes[:, :, 1] * np.cos(t) + stokes[:, :, 2] * np.sin(t)), "_behind_polariser"
    if displayable(target.rgb[inside]):
        figures = radiance_figures(seen, target.rgb, inside)
        distance = lpips(srgb_encode(seen), srgb_encode(target.rgb))
        figures |= {"lpips": distance} if distance is not None else {}
        out |= {f"{name}{suffix}": value for name, value in figures.items()}
    found = explained(seen[inside], target.rgb[inside], polarised, facts.get("noise") or 0.0)
    named = {"likeness": found.likeness, "off": found.off, "polarisation_unexplained": found.polarisation}
    return out | {name: value for name, value in named.items() if value is not None}


def _material(table: Table, truth: Truth) -> None:
    material = truth.document("material.json") or {}
    for name, value in (("ior", material.get("ior")), ("roughness", material.get("alpha"))):
        mean = table.figures.get(f"{name}_mean")
        if value is not None and mean is not None:
            true = float(value) ** 0.5 if name == "roughness" else float(value)  # alpha = r^2
            table.figures[f"{name}_error"] = abs(mean - true)
        table.missing([f"{name}_error"], "the capture has no gt/material.json that tells it")


def _environment(table: Table, train: Path, truth: Truth) -> None:
    true, fitted = truth.environment, train / files.ENVIRONMENT
    if true.is_file() and fitted.is_file():
        table.figures |= environment_figures(read_image(fitted, RGB), read_image(true, RGB))
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
