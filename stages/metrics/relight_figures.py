"""Relit images against renderings under the same maps; a light stage's two ways of relighting against each other."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from pipeline.formats import dataset_files as files
from pipeline.formats.ground_truth import Truth
from pipeline.formats.images import RGB, S0, read_image, read_mask, srgb_encode

from .image_figures import psnr, ssim
from .table import Table

FIGURES = ("psnr_srgb", "psnr_srgb_scaled", "ssim", "scale_r", "scale_g", "scale_b")


def relight_table(relight: Path, truth: Truth) -> Table:
    """One part per environment with its views as rows."""
    table = Table()
    for folder in files.subfolders(relight):
        part = Table()
        for view, path in truth.images(f"relight/{folder.name}"):
            image, true = read_image(files.relit(folder, view), S0), read_image(path, S0)
            part.rows.append({"view": view, **relight_figures(image, true)})
        part.means()
        part.figures["views"] = len(part.rows)
        part.missing(FIGURES, f"the capture has no gt/relight/{folder.name}")
        table.parts[folder.name] = part
    return table


def relight_figures(image: np.ndarray, truth: np.ndarray) -> dict[str, float]:
    """Errors of a linear image [H, W, 3] as it is and after the best factor per channel (what a fit leaves open)."""
    a, b = image.astype(np.float64), truth.astype(np.float64)
    scale = (a * b).sum((0, 1)) / np.maximum((a * a).sum((0, 1)), 1e-9)  # a black image has no best factor
    shown = srgb_encode(b)
    return {
        "psnr_srgb": psnr(srgb_encode(a), shown),
        "psnr_srgb_scaled": psnr(srgb_encode(a * scale), shown),
        "ssim": ssim(srgb_encode(a), shown),
        **{f"scale_{c}": float(s) for c, s in zip("rgb", scale)},
    }


def light_stage_table(relight: Path, masks: Path | None) -> Table:
    """How well the fitted maps explain the frames: PSNR between the two relit images of each camera."""
    table = Table()
    for folder in files.subfolders(relight):
        part = Table()
        for summed in sorted(folder.glob(f"cam*{files.SUMMED}.exr")):
            name = summed.stem.removesuffix(files.SUMMED)
            if not files.relit(folder, name).exists():
                continue
            a, b = (srgb_encode(read_image(p, RGB)) for p in (files.relit(folder, name), summed))
            mask = read_mask(files.mask(masks, name)) if masks and files.mask(masks, name).exists() else None
            row: dict[str, Any] = {"view": name, "maps_vs_frames_psnr": psnr(a, b), "maps_vs_frames_ssim": ssim(a, b)}
            if mask is not None and mask.any():
                row["maps_vs_frames_psnr_foreground"] = psnr(a, b, mask)
            part.rows.append(row)
        part.means()
        part.missing(["psnr_srgb"], "a light stage's relit images have no truth")
        table.parts[folder.name] = part
    return table
