"""Relit images against renderings under the same maps; a light stage's two ways of relighting against each other."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from pipeline.formats import dataset_files as files
from pipeline.formats.ground_truth import Truth
from pipeline.formats.images import RGB, S0, channel_names, image_size, read_image, read_mask, read_stokes, srgb_encode

from .hdr_flip import hdr_flip
from .image_figures import polarisation_figures, psnr, ssim
from .table import Table

FIGURES = (
    "psnr_srgb", "psnr_srgb_scaled", "psnr_foreground", "psnr_foreground_scaled", "ssim", "hdr_flip", "hdr_flip_foreground",
    "scale_r", "scale_g", "scale_b",
)  # fmt: skip
POLARISATION = ("dolp_mae", "aolp_mae_deg")
LEAST_FACTOR, MOST_FACTOR = 1 / 16, 16.0  # between which the best factor is looked for


def relight_table(relight: Path, masks: Path | None, truth: Truth) -> Table:
    """One part per environment with its views as rows."""
    table = Table()
    for folder in files.subfolders(relight):
        part = Table()
        for view, path in truth.images(f"relight/{folder.name}"):
            polarised = "S1.R" in channel_names(path)
            true = read_stokes(path) if polarised else read_image(path, S0)[:, :, None]
            image = read_stokes(files.relit(folder, view))
            inside = covered(files.mask(masks, view) if masks else None, true[:, :, 0])
            part.rows.append({"view": view, **relight_figures(image[:, :, 0], true[:, :, 0], inside)})
            if polarised and inside.any():
                part.rows[-1] |= polarisation_figures(image, true, inside)
        part.means()
        part.figures["views"] = len(part.rows)
        reason = f"the capture has no gt/relight/{folder.name}"
        part.missing(POLARISATION, "its truth holds no Stokes vectors" if part.rows else reason)
        part.missing(FIGURES, "its truth is black" if part.rows else reason)
        table.parts[folder.name] = part
    return table


def covered(mask: Path | None, truth: np.ndarray) -> np.ndarray:
    """Wholly covered pixels [H, W], by the view's mask; by where the truth [H, W, 3] shows anything where there is none."""
    if mask is not None and mask.exists() and image_size(mask) == truth.shape[1::-1]:
        return np.asarray(read_image(mask)[..., 0] > 0.99)
    return np.asarray(truth.mean(-1) > 0)


def relight_figures(image: np.ndarray, truth: np.ndarray, inside: np.ndarray) -> dict[str, float]:
    """Errors of a linear image [H, W, 3], over the frame and over the pixels `inside` [H, W], as it is and after the factor
    per channel that makes that very figure best (what a fit leaves open)."""
    a, b = image.astype(np.float64), truth.astype(np.float64)
    encoded, shown = srgb_encode(a), srgb_encode(b)
    scale = best_factors(a, b)
    out = {"psnr_srgb": psnr(encoded, shown), "psnr_srgb_scaled": psnr(srgb_encode(a * scale), shown)}
    if inside.any():
        own = best_factors(a[inside], b[inside])
        out["psnr_foreground"] = psnr(encoded, shown, inside)
        out["psnr_foreground_scaled"] = psnr(srgb_encode(a * own), shown, inside)
        error = hdr_flip(a, b, inside)
        if error is not None:
            out |= {"hdr_flip": float(error.mean()), "hdr_flip_foreground": float(error[inside].mean())}
    return out | {"ssim": ssim(encoded, shown)} | {f"scale_{c}": float(s) for c, s in zip("rgb", scale)}


def best_factors(image: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """Factor per channel [3] of a linear image [..., 3] with the least squared error of what is shown (sRGB, clipped).

    Least squares in radiance, where lamps past white weigh most, may score worse than no factor at all. 0 for a black channel.
    """
    from scipy.optimize import minimize_scalar

    out = np.zeros(3)
    for c in range(3):
        a, b = image[..., c].ravel(), truth[..., c].ravel()
        seen = (a > 0) | (b > 0)
        a, shown = a[seen], srgb_encode(b[seen]).astype(float)
        if not a.any():
            continue

        def error(stops: float, a: np.ndarray = a, shown: np.ndarray = shown) -> float:
            return float(((srgb_encode(a * 2**stops) - shown) ** 2).sum())

        bounds = (np.log2(LEAST_FACTOR), np.log2(MOST_FACTOR))
        found = float(minimize_scalar(error, bounds=bounds, method="bounded", options={"xatol": 1e-4}).x)
        out[c] = 2 ** min((found, 0.0), key=error)
    return out


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
