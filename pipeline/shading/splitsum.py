"""Split-sum tables: what a rough dielectric mirrors of a constant environment, and how polarised, by quadrature.

Two models of the Fresnel term F(v.h) inside the lobe's integral A = int D G F/(4 (n.v)(n.l)) (n.l) dl:
- "schlick": A = F0 tau0 + tau1 (PhyGaP Eqs. 16-18), table (tau0, tau1) in (r, n.v);
- "exact": A = F(n.v) rho, and the polarisation of the mirrored light beta sin^2, table (rho, beta) in (eta, r, n.v).
  For a mirror rho is 1 and beta is beta_s(n.v)/sin^2. beta_s belongs to the facet, not to the surface: half vectors
  spread the plane of incidence, which weakens the polarisation of rough surfaces and moves Brewster's maximum.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import torch
from numpy.typing import NDArray

from pipeline.optics import fresnel, microfacet

Float = NDArray[np.float64]

# Grid: roughness 0..1, cosine 0..1 uniform in its square root (the grazing end bends most), eta 1..2.6. Between nodes rho is
# off by 0.3 % at most from n.v = 0.05 and eta = 1.3 on (0.7 % with 25 nodes in roughness), beta by 0.4 % (1.2 % with 9 in eta).
ROUGHNESS_NODES = 33
COSINE_NODES = 33
IOR_NODES = 17
IOR_RANGE = (1.0, 2.6)
# Quadrature over the half vector: Gauss nodes in the lobe's own measure, azimuths over half a circle (symmetry).
LOBE_NODES = 32
AZIMUTHS = 32
# Ends of the grid where the ratios are 0/0 but have limits: evaluated this far inside. Near normal incidence the
# azimuthal average cancels to sin^2 of itself, which wants a visible sine.
MIN_IOR, MIN_COSINE, MAX_COSINE = 1 + 1e-4, 1e-4, 0.99


def half_vectors(alpha: float, lobe: str, nodes: int, azimuths: int) -> tuple[Float, Float, Float]:
    """(tan(theta_h) [n], azimuth [m], weight [n]) with sum(weight) = 1 in the measure D (n.h) d omega.

    alpha: roughness squared; lobe: "ggx" or "beckmann"; nodes n: Gauss nodes in polar angle; azimuths m: over half a circle.
    """
    x, w = np.polynomial.legendre.leggauss(nodes)
    u = (x + 1) / 2
    tan2 = alpha**2 * (u / (1 - u) if lobe == "ggx" else -np.log1p(-u))
    return np.sqrt(tan2), (np.arange(azimuths) + 0.5) * np.pi / azimuths, w / 2


def reflected(
    cosines: Float, alpha: float, lobe: str, nodes: int = LOBE_NODES, azimuths: int = AZIMUTHS
) -> tuple[Float, Float, Float]:
    """(v.h, weight, cos 2 chi) [C, n, m] of the lobe seen from each cosine.

    sum(weight F(v.h)) is the directional albedo; chi is the angle between the planes of incidence on the facet and
    on the surface, seen along the view. cosines [C] of the view with the normal; the rest as in `half_vectors`.
    """
    tan, phi, w = half_vectors(alpha, lobe, nodes, azimuths)
    nh = 1 / np.sqrt(1 + tan * tan)[:, None]
    hx, hy = tan[:, None] * nh * np.cos(phi), tan[:, None] * nh * np.sin(phi)
    c = cosines[:, None, None]
    s = np.sqrt((1 - c) * (1 + c))
    vh = s * hx + c * nh
    nl = 2 * vh * nh - c
    lit = (vh > 0) & (nl > 0)
    shadow = microfacet.separable_shadowing(c, np.where(lit, nl, 1.0), np.asarray(alpha), lobe)
    weight = np.where(lit, shadow * vh / (c * nh), 0) * (w / azimuths)[:, None]
    # Across the view the normal lies along -x', the facet at (hx c - nh s, hy).
    along = nh * s - hx * c
    square = along**2 + hy**2
    turn = np.divide(along**2 - hy**2, square, out=np.ones_like(square), where=square > 0)
    return np.clip(vh, 0, 1), weight, turn


def _cosines() -> Float:
    return np.clip(np.linspace(0, 1, COSINE_NODES) ** 2, MIN_COSINE, MAX_COSINE)


def _alphas() -> Float:
    return np.maximum(np.linspace(0, 1, ROUGHNESS_NODES), microfacet.MIN_ROUGHNESS) ** 2


@lru_cache(maxsize=4)
def schlick_table(lobe: str = "ggx") -> NDArray[np.float32]:
    """(tau0, tau1) [roughness, cosine, 2]."""
    out = np.empty((ROUGHNESS_NODES, COSINE_NODES, 2), np.float32)
    for k, alpha in enumerate(_alphas()):
        vh, weight, _ = reflected(_cosines(), alpha, lobe)
        m = (1 - vh) ** 5
        out[k] = np.stack(((weight * (1 - m)).sum((1, 2)), (weight * m).sum((1, 2))), -1)
    return out


@lru_cache(maxsize=4)
def exact_table(lobe: str = "ggx") -> NDArray[np.float32]:
    """Compute the split-sum table of exact Fresnel reflection.

    Args:
        lobe: "ggx" or "beckmann".

    Returns:
        rho (albedo over F(n.v)) and beta (polarisation over sin^2(n.v)), by IoR, roughness, cosine. [eta, roughness, cosine, 2]
    """
    out = np.empty((IOR_NODES, ROUGHNESS_NODES, COSINE_NODES, 2), np.float32)
    c = _cosines()
    sin2 = (1 - c) * (1 + c)
    for k, alpha in enumerate(_alphas()):
        vh, weight, turn = reflected(c, alpha, lobe)
        for e, eta in enumerate(np.maximum(np.linspace(*IOR_RANGE, IOR_NODES), MIN_IOR)):
            across, along = fresnel.reflectances(vh, np.asarray(eta))
            albedo = (weight * (across + along)).sum((1, 2)) / 2
            polarised = (weight * (across - along) * turn).sum((1, 2)) / 2
            out[e, k, :, 0] = albedo / fresnel.reflectance(c, np.asarray(eta))
            out[e, k, :, 1] = polarised / (albedo * sin2)
    return out


@lru_cache(maxsize=8)
def table_on(fresnel_model: str, lobe: str, device: torch.device) -> torch.Tensor:
    """`exact_table` or `schlick_table` ("exact" or "schlick"), copied to a device once."""
    return torch.as_tensor((exact_table if fresnel_model == "exact" else schlick_table)(lobe), device=device)


def lookup(values: torch.Tensor, coordinates: tuple[torch.Tensor, ...]) -> torch.Tensor:
    """Multilinear lookup [P, C] of a table [n1, .., nk, C] at coordinates [P] in node units (clipped to the grid)."""
    corners: list[tuple[torch.Tensor, torch.Tensor]] = [
        (torch.zeros((), dtype=torch.long, device=values.device), values.new_ones(()))
    ]
    for size, x in zip(values.shape, coordinates):
        x = x.clamp(0, size - 1)
        i = x.detach().floor().long().clamp(0, size - 2)
        t = x - i
        corners = [(row * size + i + k, w * (t if k else 1 - t)) for row, w in corners for k in (0, 1)]
    flat = values.reshape(-1, values.shape[-1])
    return torch.stack([w[:, None] * flat[row] for row, w in corners]).sum(0)
