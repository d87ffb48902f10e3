"""What a camera sees of a textured mesh's texture, unlit: the mean over each pixel."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from pipeline.geometry.cameras import Camera
from pipeline.geometry.rays import RayMesh

SUB = 4
"""Rays a side of a pixel."""


def seen_texture(
    vertices: NDArray, faces: NDArray, uv: NDArray, image: NDArray, camera: Camera
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Look at a texture on its mesh.

    Args:
        vertices: world. [V, 3]
        faces: vertex numbers. [F, 3]
        uv: texture coordinates, 0..1, v from the first row on. [V, 2]
        image: the texture. [H, W, C]
        camera: which looks.

    Returns:
        The mean of what the pixel shows of the texture, 0 where that is nothing [h, w, C]; the pixel's covered share [h, w].
    """
    from scipy.ndimage import map_coordinates

    scale = {name: SUB * getattr(camera, name) for name in ("width", "height", "fx", "fy", "cx", "cy")}
    rays = replace(camera, **scale).rays()
    hits = RayMesh(vertices, faces).cast(camera.centre, rays)
    hit = hits.hit
    at = np.einsum("nkc,nk->nc", uv[faces[hits.triangle[hit]]], hits.weights[hit])
    height, width, channels = image.shape
    place = [at[:, 1] * height - 0.5, at[:, 0] * width - 0.5]
    fine = np.zeros((*hit.shape, channels), np.float32)
    for k in range(channels):
        fine[hit, k] = map_coordinates(image[..., k], place, order=1, mode="nearest")
    blocks = (camera.height, SUB, camera.width, SUB)
    covered = hit.reshape(blocks).mean((1, 3)).astype(np.float32)
    total = fine.reshape(*blocks, channels).mean((1, 3))
    return np.divide(total, covered[..., None], out=np.zeros_like(total), where=covered[..., None] > 0), covered
