"""Lobes of renderers: nearly all know GGX alone, and ours may be Gaussian."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

GGX = "ggx"
GGX_FROM_GAUSSIAN = 0.92479
"""Alpha of the GGX lobe nearest to a Beckmann lobe (or Ward's: both are Gaussians of the slope) over the Gaussian's own.

Nearest: least squares of the slopes' densities exp(-t^2) / pi and a^2 / (pi (a^2 + t^2)^2); slopes scale with alpha, and so one
ratio does for all. A GGX lobe of the Gaussian's own alpha has a peak as high, and longer tails that take light from its flank.
"""


def ggx_roughness(roughness: NDArray[np.float32], lobe: str) -> NDArray[np.float32]:
    """Roughness for programs whose lobe is GGX.

    Args:
        roughness: of our lobe; alpha is its square. [...]
        lobe: "ggx", or a Gaussian one: "beckmann", "ward", or as Polarized Reflectance Fields prints it.

    Returns:
        Roughness of the nearest GGX lobe. [...]
    """
    return of_another_lobe(roughness, lobe, GGX)


def of_another_lobe(roughness: NDArray[np.float32], lobe: str, wanted: str) -> NDArray[np.float32]:
    """Roughness of the nearest lobe of another form.

    Args:
        roughness: of a lobe; alpha is its square. [...]
        lobe, wanted: "ggx", or Gaussian ones, which are alike ("beckmann", "ward", Polarized Reflectance Fields' own).

    Returns:
        Roughness of the lobe `wanted`. [...]
    """
    if (lobe == GGX) == (wanted == GGX):
        return roughness
    ratio = np.float32(np.sqrt(GGX_FROM_GAUSSIAN))
    return roughness * ratio if wanted == GGX else roughness / ratio
