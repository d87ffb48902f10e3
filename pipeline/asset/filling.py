"""Texels without a value: those that no view sees, and those beside the charts."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

NEIGHBOURS = 4


def from_neighbours(values: NDArray, known: NDArray[np.bool_], position: NDArray) -> NDArray[np.float32]:
    """Values [T, C] with those not known [T] taken from the nearest known ones in space, weighted by inverse distance.

    position [T, 3]. Raises ValueError where none is known.
    """
    from scipy.spatial import cKDTree

    if not known.any():
        raise ValueError("no texel is seen by any view")
    if known.all():
        return values
    distance, near = cKDTree(position[known]).query(position[~known], k=min(NEIGHBOURS, int(known.sum())))
    distance, near = (x.reshape(int((~known).sum()), -1) for x in (distance, near))
    weight = 1 / np.maximum(distance, np.finfo(np.float32).tiny)
    weight /= weight.sum(1, keepdims=True)
    out = values.copy()
    out[~known] = np.einsum("tk,tkc->tc", weight, values[known][near])
    return out


def texture(
    values: NDArray, index: NDArray[np.int64], nearest: NDArray[np.int64], shape: tuple[int, int]
) -> NDArray[np.float32]:
    """The texture of values at some texels; all others take the nearest one's.

    So neither filtering nor smaller textures mix anything into a seam.

    Args:
        values: of the texels. [T, C]
        index: of the texels in the flattened texture. [T]
        nearest: `nearest_texel` of them. [H * W]
        shape: (H, W).

    Returns:
        The texture. [H, W, C]
    """
    height, width = shape
    flat = np.zeros((height * width, values.shape[1]), np.float32)
    flat[index] = values
    return flat[nearest].reshape(height, width, -1)


def nearest_texel(index: NDArray[np.int64], shape: tuple[int, int]) -> NDArray[np.int64]:
    """For every texel of a texture the nearest of some.

    Args:
        index: of those in the flattened texture. [T]
        shape: (H, W).

    Returns:
        Indices into the flattened texture. [H * W]
    """
    from scipy.ndimage import distance_transform_edt

    height, width = shape
    empty = np.ones(height * width, bool)
    empty[index] = False
    row, column = distance_transform_edt(empty.reshape(shape), return_distances=False, return_indices=True)
    return np.asarray(row.astype(np.int64) * width + column).ravel()
