"""Which figures a page shows, in which words and units."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Figure:
    """A figure's words: title, unit, digits after the point, and factor to the unit."""

    title: str
    unit: str = ""
    digits: int = 2
    factor: float = 1.0


FIGURES = {
    "psnr_srgb": Figure("PSNR, full frame", "dB"),
    "psnr_foreground": Figure("PSNR, object only", "dB"),
    "ssim": Figure("SSIM", "", 4),
    "psnr_srgb_behind_polariser": Figure("PSNR behind the polariser", "dB"),
    "psnr_foreground_behind_polariser": Figure("PSNR behind the polariser, object", "dB"),
    "ssim_behind_polariser": Figure("SSIM behind the polariser", "", 4),
    "normal_mae_deg": Figure("Normals, mean error", "°"),
    "normal_cosine_distance": Figure("Normals, cosine distance", "", 4),
    "dolp_mae": Figure("DoLP, mean error", "", 4),
    "aolp_mae_deg": Figure("AoLP, mean error", "°"),
    "likeness": Figure("Likeness to the photograph, 1: alike", "", 3),
    "off": Figure("Radiance off, of its mean as the eye sees it", "%", 1, 100),
    "polarisation_unexplained": Figure("Polarised light not explained", "%", 1, 100),
    "ior_mean": Figure("Index of refraction, mean", "", 3),
    "ior_error": Figure("Index of refraction, error", "", 3),
    "roughness_mean": Figure("Roughness, mean", "", 3),
    "roughness_error": Figure("Roughness, error", "", 3),
    "albedo_rel_error": Figure("Albedo, median error", "%", 1, 100),
    "albedo_rel_error_scaled": Figure("Albedo at best scale, median error", "%", 1, 100),
    "roughness_map_error": Figure("Roughness map, mean error", "", 3),
    "ior_map_error": Figure("Index of refraction map, mean error", "", 3),
    "psnr_diffuse": Figure("PSNR of the diffuse part", "dB"),
    "psnr_specular": Figure("PSNR of the specular part", "dB"),
    "lpips": Figure("LPIPS", "", 4),
    "lpips_behind_polariser": Figure("LPIPS behind the polariser", "", 4),
    "specular_albedo_rel_median": Figure("Specular albedo, median error of a pixel", "%", 2, 100),
    "sigma_map_rel_median": Figure("σ, median error of a pixel", "%", 2, 100),
    "sigma_map_rel_median_u": Figure("Larger σ, median error of a pixel", "%", 2, 100),
    "sigma_map_rel_median_v": Figure("Smaller σ, median error of a pixel", "%", 2, 100),
    "occlusion_error": Figure("Occlusion, mean error", "", 4),
    "holes_pct": Figure("Holes in the object", "%", 3),
    "env_psnr": Figure("Environment, PSNR", "dB"),
    "env_psnr_scaled": Figure("Environment, PSNR at best scale", "dB"),
    "env_log_correlation": Figure("Environment, log correlation", "", 3),
    "chamfer_pct": Figure("Mesh, chamfer distance", "%", 3),
    "accuracy_pct": Figure("Mesh, accuracy", "%", 3),
    "completeness_pct": Figure("Mesh, completeness", "%", 3),
    "fscore_1pct": Figure("Mesh, F-score at 1 %", "", 4),
    "seen_median_pct": Figure("Mesh where a camera sees it, median distance", "%", 3),
    "seen_p90_pct": Figure("Mesh where a camera sees it, distance at 90 %", "%", 3),
    "disagreement_normal_deg": Figure("Cameras' normals against all together", "°", 2),
    "disagreement_diffuse_albedo": Figure("Cameras' diffuse albedo against all together", "", 4),
    "disagreement_specular_albedo": Figure("Cameras' specular albedo against all together", "", 4),
    "disagreement_sigma": Figure("Cameras' σ against all together", "", 4),
    "chamfer_mm": Figure("Mesh, chamfer distance", "mm", 3),
    "accuracy_mm": Figure("Mesh, accuracy", "mm", 3),
    "completeness_mm": Figure("Mesh, completeness", "mm", 3),
    "genus": Figure("Mesh, handles (genus)", "", 0),
    "components": Figure("Mesh, pieces", "", 0),
    "self_intersecting_pct": Figure("Mesh, triangles that cross others", "%", 3),
    "inside_out_pct": Figure("Mesh, area that looks inward", "%", 3),
    "triangles": Figure("Mesh, triangles", "", 0),
    "psnr_srgb_scaled": Figure("PSNR at best scale per channel", "dB"),
    "psnr_foreground_scaled": Figure("PSNR of the object, at best scale", "dB"),
    "hdr_flip": Figure("HDR-FLIP, full frame", "", 4),
    "hdr_flip_foreground": Figure("HDR-FLIP of the object", "", 4),
    "maps_vs_frames_psnr": Figure("Maps against frames, PSNR", "dB"),
    "maps_vs_frames_psnr_foreground": Figure("Maps against frames, object", "dB"),
    "maps_vs_frames_ssim": Figure("Maps against frames, SSIM", "", 4),
    "diffuse_normal_median_deg": Figure("Diffuse normals, median error", "°"),
    "specular_normal_median_deg": Figure("Specular normals, median error", "°"),
    "normal_median_deg": Figure("Normals, median error", "°"),
    "normal_mean_deg": Figure("Normals, mean error", "°"),
    "albedo_rel_median": Figure("Diffuse albedo, median error", "%", 2, 100),
    "albedo_rel_mean": Figure("Diffuse albedo, mean error", "%", 2, 100),
    "sigma_rel_error_u": Figure("Larger σ, error of the median", "%", 1, 100),
    "sigma_rel_error_v": Figure("Smaller σ, error of the median", "%", 1, 100),
    "sigma_median_u": Figure("Larger σ, median", "", 3),
    "sigma_median_v": Figure("Smaller σ, median", "", 3),
    "specular_albedo_median": Figure("Specular albedo, median", "", 3),
    "tangent_median_deg": Figure("Tangent, median error", "°"),
    "residual_median": Figure("Residual of the fit, median", "%", 2, 100),
    "flagged_pct": Figure("Flagged pixels", "%", 1),
    "pixels": Figure("Pixels of the object", "", 0),
    "diffuse_normal_mean_deg": Figure("Diffuse normals, mean error", "°"),
    "diffuse_normal_p90_deg": Figure("Diffuse normals, 90th percentile", "°"),
    "specular_normal_mean_deg": Figure("Specular normals, mean error", "°"),
    "specular_normal_p90_deg": Figure("Specular normals, 90th percentile", "°"),
    "normal_p90_deg": Figure("Normals, 90th percentile", "°"),
    "scale_r": Figure("Best factor, red", "", 3),
    "scale_g": Figure("Best factor, green", "", 3),
    "scale_b": Figure("Best factor, blue", "", 3),
    "polariser_error_deg": Figure("Polariser angles, error", "°"),
    "saturated_fraction": Figure("Saturated samples", "%", 3, 100),
    "noise": Figure("Noise of a sample", "", 5),
    "coverage": Figure("Object in the frame", "%", 1, 100),
    "wall_s": Figure("Wall time", "s", 1),
    "cpu_s": Figure("Processor time", "s", 1),
    "peak_rss_mb": Figure("Peak memory", "MB", 0),
    "condition": Figure("Condition of the polariser angles", "", 1),
}
HEADLINES = {
    "train": ("psnr_srgb", "psnr_foreground", "normal_mae_deg", "dolp_mae", "aolp_mae_deg", "env_log_correlation"),
    "mesh": ("chamfer_pct",),
    "olat": ("diffuse_normal_median_deg", "normal_median_deg", "albedo_rel_median", "sigma_rel_error_u", "residual_median"),
}
SKIPPED = ("views", "why", "wall_s", "cpu_s", "peak_rss_mb", "left_out")


def describe(name: str) -> Figure:
    """Words for a figure, made from its name where none are written down."""
    if name in FIGURES:
        return FIGURES[name]
    for ending, unit in (("_deg", "°"), ("_pct", "%"), ("_s", "s"), ("_mb", "MB")):
        if name.endswith(ending):
            return Figure(name.removesuffix(ending).replace("_", " "), unit)
    return Figure(name.replace("_", " "), "", 3)


def text_of(name: str, value: Any) -> str:
    """A value as text with its unit; an en dash for what is not known."""
    if value is None:
        return "–"
    if isinstance(value, Mapping):
        return ", ".join(f"{k} {text_of(name, v)}" for k, v in value.items())
    if isinstance(value, list):
        return ", ".join(text_of(name, v) for v in value)
    if isinstance(value, bool) or not isinstance(value, int | float):
        return str(value)
    f = describe(name)
    number = f"{value * f.factor:,.{f.digits}f}".replace(",", " ")
    return number + (f.unit if f.unit == "°" else f" {f.unit}" if f.unit else "")


def headlines(metrics: Mapping[str, Any]) -> list[dict[str, str]]:
    """Tiles at the top: what a reader wants first."""
    tiles = []
    for stage, names in HEADLINES.items():
        for name in names:
            value = metrics.get(stage, {}).get(name)
            if value is not None:
                number, _, unit = text_of(name, value).rstrip("°").partition(" ")
                unit = unit or ("°" if text_of(name, value).endswith("°") else "")
                tiles.append({"value": number, "unit": unit, "title": describe(name).title})
    relit = [(n, t["psnr_srgb"]) for n, t in metrics.get("relight", {}).items() if isinstance(t, dict) and t.get("psnr_srgb")]
    for name, value in relit:
        tiles.append({"value": f"{value:.2f}", "unit": "dB", "title": f"Relit under {name}"})
    return tiles


def tables(metrics: Mapping[str, Any]) -> list[dict[str, Any]]:
    """A table of figures, with reasons and rows per view, for every stage and part."""
    out: list[dict[str, Any]] = []
    for stage, table in metrics.items():
        if not isinstance(table, Mapping) or stage in SKIPPED:
            continue
        out += _tables_of(stage, table)
    return [t for t in out if t["figures"] or t["rows"]]


def _tables_of(title: str, table: Mapping[str, Any]) -> list[dict[str, Any]]:
    why = table.get("why", {})
    figures, parts = [], []
    order = {name: k for k, name in enumerate(FIGURES)}
    for name, value in sorted(table.items(), key=lambda item: order.get(item[0], len(order))):
        if name in SKIPPED:
            continue
        if isinstance(value, Mapping) and any(key in value for key in ("views", "why", "pixels", "triangles")):
            if "pixels" not in value or "why" in value:  # a camera's figures are in the rows
                parts += _tables_of(f"{title}: {name}", value)
            continue
        figures.append({"title": describe(name).title, "name": name, "value": text_of(name, value), "why": why.get(name, "")})
    listed = table.get("views")
    rows: list[dict[str, Any]] = listed if isinstance(listed, list) else []
    columns = list(dict.fromkeys(k for row in rows for k in row if k != "view"))
    body = [{"view": row["view"], "cells": [text_of(c, row.get(c)) for c in columns]} for row in rows]
    heads = [describe(c).title for c in columns]
    return [{"title": title, "figures": figures, "heads": heads, "rows": body}, *parts]
