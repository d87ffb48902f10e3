"""A light stage's maps pixel by pixel: specular albedo, widths and occlusion against gt/maps.npz, or the one true value."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.formats import dataset_files as files
from pipeline.formats.images import read_image

from .table import Table

FIGURES = ("specular_albedo_rel_median", "sigma_map_rel_median", "occlusion_error")


def add_map_figures(
    part: Table, folder: Path, brdf: Mapping[str, Any] | None, truth: Mapping[str, NDArray] | None, inside: NDArray[np.bool_]
) -> None:
    """Add median relative errors of specular albedo and widths (larger first) and the mean error of the diffuse occlusion,
    over the pixels `inside` [H, W]. Where maps.npz has no such map, gt_brdf.json's one value is every pixel's."""
    maps, one = truth or {}, brdf or {}
    specular = maps["specular_albedo"][inside] if "specular_albedo" in maps else one.get("specular")
    if specular is not None:
        fitted = read_image(files.camera_map(folder, "specular_albedo"), ("Y",))[..., 0][inside]
        part.figures["specular_albedo_rel_median"] = float(np.median(_relative(fitted, specular)))
    sigma = maps["sigma"][inside] if "sigma" in maps else one.get("sigma")
    if sigma is not None:
        fitted = read_image(files.camera_map(folder, "sigma"), ("X", "Y"))[inside]
        wide_first = -np.sort(-np.asarray(sigma, np.float64), axis=-1)
        part.figures["sigma_map_rel_median"] = [float(v) for v in np.median(_relative(fitted, wide_first), 0)]
    if "occlusion" in maps:
        fitted = read_image(files.camera_map(folder, "occlusion_d"), ("Y",))[..., 0][inside]
        part.figures["occlusion_error"] = float(np.abs(fitted - maps["occlusion"][inside]).mean())
    part.missing(FIGURES[:2], f"neither {folder.name}/gt/maps.npz nor gt_brdf.json tells it")
    part.missing(FIGURES[2:], f"{folder.name}/gt/maps.npz has no occlusion")


def _relative(fitted: NDArray, true: Any) -> NDArray[np.float64]:
    true = np.asarray(true, np.float64)
    return np.abs(fitted - true) / np.maximum(true, 1e-6)
