"""A view's albedo, roughness and index of refraction against gt/material, and what of the object the model leaves open."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pipeline.formats.gbuffer import SurfaceImage
from pipeline.formats.images import read_image

from .image_figures import erode

CHANNELS = ("albedo.R", "albedo.G", "albedo.B", "roughness", "ior")
MAPS = ("albedo_rel_error", "albedo_rel_error_scaled", "roughness_map_error", "ior_map_error")
INSIDE_PX = 2  # from the edge of what the truth covers: nearer, a pixel mixes materials
DARKEST = 0.02  # albedo below which an error is no longer taken relative to it
HOLE = 0.5  # alpha below which a pixel wholly inside the mask is one


def holes_pct(alpha: NDArray[np.float32], inside: NDArray[np.bool_]) -> float:
    """Percent of the pixels wholly inside the mask [H, W] through which the model lets more than half of the light."""
    return float(100 * (alpha[inside] < HOLE).mean())


def material_figures(path: Path, surface: SurfaceImage, inside: NDArray[np.bool_]) -> dict[str, float]:
    """Errors of the maps of one view.

    Args:
        path: gt/material/VIEW.exr, the channels of `CHANNELS`; ior 0 where the object is not.
        surface: the model's buffers of that view. [H, W]
        inside: pixels that the object covers wholly. [H, W]

    Returns:
        Median relative error of the albedo, as it is and at the best factor of each channel (what light and albedo share is
        not determined); mean absolute error of roughness and of the index. Empty where the sizes differ or nothing is left.

    Raises:
        UserError: the file cannot be read, or lacks a channel.
    """
    true = read_image(path, CHANNELS)
    if true.shape[:2] != inside.shape or surface.albedo.shape[:2] != inside.shape:
        return {}
    where = erode((true[..., 4] > 0) & inside, INSIDE_PX)
    if not where.any():
        return {}
    albedo, given = surface.albedo[where].astype(np.float64), true[where][:, :3].astype(np.float64)
    factor = (albedo * given).sum(0) / np.maximum((albedo**2).sum(0), 1e-12)  # all black: no factor helps
    floor = np.maximum(given, DARKEST)
    return {
        "albedo_rel_error": float(np.median(np.abs(albedo - given) / floor)),
        "albedo_rel_error_scaled": float(np.median(np.abs(albedo * factor - given) / floor)),
        "roughness_map_error": float(np.abs(surface.roughness - true[..., 3])[where].mean()),
        "ior_map_error": float(np.abs(surface.ior - true[..., 4])[where].mean()),
    }
