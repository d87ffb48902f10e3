"""Two widths of a lobe as file formats say them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def in_gltf(roughness: NDArray[np.float32], anisotropy: NDArray[np.float32]) -> tuple[NDArray, NDArray]:
    """Roughness and anisotropy strength as KHR_materials_anisotropy has them: alpha across the direction is roughness squared,
    and along it alpha + (1 - alpha) strength squared.

    roughness: r with r^4 the product of the two alphas; anisotropy: 1 - the smaller over the larger.
    """
    ratio = np.maximum(1.0 - anisotropy, 1e-3)
    across = roughness**2 * np.sqrt(ratio)
    excess = across * (1 / ratio - 1) / np.maximum(1 - across, 1e-6)
    return np.sqrt(across), np.sqrt(np.clip(excess, 0, 1))
