"""Gaussians in binary glTF: KHR_gaussian_splatting (Khronos, release candidate of 2026), our material channels beside it."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pipeline.formats.gltf import GltfParts
from pipeline.formats.images import srgb_decode

from .cloud import SplatCloud
from .harmonics import CONSTANT, DEGREE

EXTENSION = "KHR_gaussian_splatting"
POINTS = 0
KIND = {1: "SCALAR", 3: "VEC3"}


def write_splat_glb(path: Path, cloud: SplatCloud, material: Mapping[str, NDArray]) -> None:
    """Write a cloud and its material. Programs without the extension show points in their mean colour.

    Args:
        path: the .glb.
        cloud: in glTF's axes (y up), metres where they are known.
        material: values by name, [N] or [N, 3], as attributes `_NAME` (glTF's way for an application's own): programs that
            know them can relight, all others take no notice.
    """
    parts = GltfParts()
    degree0 = np.clip(CONSTANT * cloud.coefficients[:, 0] + 0.5, 0, 1)
    opacity = 1 / (1 + np.exp(-cloud.opacity))
    attributes = {
        "POSITION": parts.array(cloud.means, "VEC3", bounds=True),
        "COLOR_0": parts.array(np.concatenate([srgb_decode(degree0), opacity[:, None]], 1), "VEC4"),
        f"{EXTENSION}:ROTATION": parts.array(_unit(cloud.quaternions[:, [1, 2, 3, 0]]), "VEC4"),
        f"{EXTENSION}:SCALE": parts.array(np.exp(cloud.log_scales), "VEC3"),
        f"{EXTENSION}:OPACITY": parts.array(opacity, "SCALAR"),
    }
    first = {degree: int(np.argmax(degree == DEGREE)) for degree in range(4)}
    for k, degree in enumerate(DEGREE.tolist()):
        name = f"{EXTENSION}:SH_DEGREE_{degree}_COEF_{k - first[degree]}"
        attributes[name] = parts.array(cloud.coefficients[:, k], "VEC3")
    for name, values in material.items():
        attributes[f"_{name.upper()}"] = parts.array(values, KIND[1 if values.ndim == 1 else values.shape[1]])
    kernel = {
        "kernel": "ellipse",
        "colorSpace": "srgb_rec709_display",
        "projection": "perspective",
        "sortingMethod": "cameraDistance",
    }
    primitive = {"attributes": attributes, "mode": POINTS, "extensions": {EXTENSION: kernel}}
    document = {
        "extensionsUsed": [EXTENSION],
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, "name": "polarfield splats"}],
        "meshes": [{"primitives": [primitive]}],
    }
    parts.write(path, document)


def _unit(quaternions: NDArray) -> NDArray:
    return quaternions / np.maximum(np.linalg.norm(quaternions, axis=1, keepdims=True), 1e-12)
