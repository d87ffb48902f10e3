"""Split-sum tables: what a rough dielectric mirrors of a constant environment, by quadrature.

For Fresnel F = F0 + (1 - F0)(1 - v.h)^5 the hemispherical integral is F0 tau0 + tau1 (PhyGaP Eqs. 16-17).
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import torch
from numpy.typing import NDArray

from pipeline.optics import microfacet

Float = NDArray[np.float64]

# Grid of the tables: roughness 0..1 and cosine 0..1, uniform in its square root (the grazing end bends most).
ROUGHNESS_NODES = 33
COSINE_NODES = 49
# Quadrature over the half vector: Gauss nodes in the lobe's own measure, azimuths on half a circle (symmetry).
LOBE_NODES = 48
AZIMUTHS = 48


def half_vectors(alpha: float, lobe: str, nodes: int, azimuths: int) -> tuple[Float, Float, Float]:
    """(tan(theta_h) [n], azimuth [m], weight [n]) with sum(weight) = 1 in the measure D (n.h) d omega."""
    x, w = np.polynomial.legendre.leggauss(nodes)
    u = (x + 1) / 2
    tan2 = alpha**2 * (u / (1 - u) if lobe == "ggx" else -np.log1p(-u))
    return np.sqrt(tan2), (np.arange(azimuths) + 0.5) * np.pi / azimuths, w / 2


def reflected(cosines: Float, alpha: float, lobe: str, nodes: int, azimuths: int) -> tuple[Float, Float]:
    """(v.h, weight) [C, n, m]: the lobe seen from each cosine; sum(weight F(v.h)) = its directional albedo."""
    tan, phi, w = half_vectors(alpha, lobe, nodes, azimuths)
    nh = 1 / np.sqrt(1 + tan * tan)[:, None]
    hx = tan[:, None] * nh * np.cos(phi)
    c = cosines[:, None, None]
    vh = np.sqrt((1 - c) * (1 + c)) * hx + c * nh
    nl = 2 * vh * nh - c
    lit = (vh > 0) & (nl > 0)
    shadow = microfacet.separable_shadowing(c, np.where(lit, nl, 1.0), np.asarray(alpha), lobe)
    weight = np.where(lit, shadow * vh / (c * nh), 0) * (w / azimuths)[:, None]
    return np.clip(vh, 0, 1), weight


@lru_cache(maxsize=4)
def table(lobe: str = "ggx") -> NDArray[np.float32]:
    """(tau0, tau1) [roughness, cosine, 2] on the grid above."""
    cosines = np.maximum(np.linspace(0, 1, COSINE_NODES) ** 2, 1e-4)  # the limit at 0 exists; 0/0 there does not
    out = np.empty((ROUGHNESS_NODES, COSINE_NODES, 2))
    for k, roughness in enumerate(np.linspace(0, 1, ROUGHNESS_NODES)):
        alpha = max(roughness, microfacet.MIN_ROUGHNESS) ** 2
        vh, weight = reflected(cosines, alpha, lobe, LOBE_NODES, AZIMUTHS)
        schlick = (1 - vh) ** 5
        out[k] = np.stack(((weight * (1 - schlick)).sum((1, 2)), (weight * schlick).sum((1, 2))), -1)
    return out.astype(np.float32)


def lookup(values: torch.Tensor, roughness: torch.Tensor, cosine: torch.Tensor) -> torch.Tensor:
    """Bilinear lookup [P, C] of a table [ROUGHNESS_NODES, COSINE_NODES, C]; arguments [P] in (0, 1]."""
    rows, cols = values.shape[:2]
    y, x = roughness * (rows - 1), cosine.sqrt() * (cols - 1)
    j = y.detach().floor().clamp(0, rows - 2).long()
    i = x.detach().floor().clamp(0, cols - 2).long()
    y, x = (y - j)[:, None], (x - i)[:, None]
    top = values[j, i] * (1 - x) + values[j, i + 1] * x
    bottom = values[j + 1, i] * (1 - x) + values[j + 1, i + 1] * x
    return top * (1 - y) + bottom * y
