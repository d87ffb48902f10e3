"""Does frame k show light k? A matte surface under the right light fits n·w in every frame; under a neighbour's it does not."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

LIT = 0.3  # of a pixel's brightest sample: above it neither shadow nor inter-reflection
LEAST_LIT = 5  # lights of a pixel that determine its three unknowns
ROUNDS = 4  # of reweighting
TUNING = 2.5  # Geman-McClure scale in standard deviations of the residual
REACH = 3  # frames that may be missing or too many at the front
DOUBTFUL = 0.15
"""Relative misfit of the lit samples above which normals mean little: 3 % noise leaves 0.05, inter-reflection in a bowl 0.1,
lights in another order 0.3 to 1."""
NOTED = 0.03  # the same, above which another order is named if it is clearly better: neighbours in a dense rig differ by little
CLEARLY = 0.5  # of the misfit: another order, or other brightnesses, must leave less than this
FEWEST = 20  # pixels, below which nothing is said


@dataclass(frozen=True)
class Order:
    """One order of the frames, `name` (empty: as they stand): light of each frame [N], and the relative misfit under it."""

    name: str
    lights: NDArray[np.intp]
    misfit: float


def lambert(light: NDArray[np.float64], w: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Albedo times normal [P, 3] of matte samples [N, P] under directions [N, 3], and the relative misfit of each pixel [P].

    Robust (Geman-McClure weights about the median residual), as the frames may hold highlights. Pixels that too few lights tell
    have misfit NaN.
    """
    lit = light > LIT * np.maximum(light.max(0), 1e-30)
    determined = lit.sum(0) >= LEAST_LIT
    products = (w[:, :, None] * w[:, None, :]).reshape(len(w), 9)
    weight, level = lit.astype(float), np.sqrt(np.sum(lit * light**2, 0) / np.maximum(lit.sum(0), 1))
    m, miss = np.zeros((light.shape[1], 3)), np.full(light.shape[1], np.nan)
    for _ in range(ROUNDS):
        matrix = (weight.T @ products).reshape(-1, 3, 3)
        scale = np.trace(matrix, axis1=1, axis2=2) / 3
        determined &= np.linalg.det(matrix) > 1e-6 * scale**3
        matrix[~determined] = np.eye(3)
        m = np.linalg.solve(matrix, ((weight * light).T @ w)[..., None])[..., 0]
        residual = np.abs(light - w @ m.T)
        miss = 1.4826 * np.nanmedian(np.where(lit | ~determined, residual, np.nan), 0)
        weight = lit / (1 + (residual / (TUNING * np.maximum(miss, 0.01 * level) + 1e-30)) ** 2) ** 2
    return m, np.where(determined, miss / np.maximum(level, 1e-30), np.nan)


def orders(count: int) -> dict[str, NDArray[np.intp]]:
    """Orders that frames may have been put in by mistake: light of each frame [N], by name."""
    k = np.arange(count)
    out = {"": k}
    for shift in [s for step in range(1, REACH + 1) for s in (step, -step)]:
        frames = "a frame" if abs(shift) == 1 else f"{abs(shift)} frames"
        fault = f"{frames} missing before it" if shift > 0 else f"{frames} too many before it"
        out[f"light k{shift:+d} for frame k ({fault})"] = (k + shift) % count
    out["their order reversed"] = k[::-1]
    return out


def as_they_stand(light: NDArray[np.float64], w: NDArray[np.float64]) -> Order | None:
    """The frames' own order under matte samples [N, P] and directions w [N, 3]; None where too few pixels tell."""
    return _tried("", np.arange(len(w)), light, w)


def fitting_orders(light: NDArray[np.float64], w: NDArray[np.float64], stands: Order) -> list[Order]:
    """Other orders of the frames that fit matte samples [N, P] under directions w [N, 3] clearly better than they stand.

    Where that misfit is no more than rounding leaves, all that are as small: a spiral of lights that is turned by one light is
    almost the same spiral.
    """
    limit = max(CLEARLY * stands.misfit, NOTED)
    tried = [_tried(name, index, light, w) for name, index in orders(len(w)).items() if name]
    return [order for order in tried if order is not None and order.misfit < limit]


def _tried(name: str, index: NDArray[np.intp], light: NDArray[np.float64], w: NDArray[np.float64]) -> Order | None:
    _, each = lambert(light, w[index])
    return Order(name, index, float(np.nanmedian(each))) if np.isfinite(each).sum() >= FEWEST else None


def light_gains(light: NDArray[np.float64], w: NDArray[np.float64]) -> NDArray[np.float64]:
    """By how much each light is brighter than a common one in each colour [N, 3]: medians over the pixels, mean 1."""
    gains = np.ones((len(w), 3))
    for c in range(3):
        sample = light[..., c]
        for _ in range(3):  # the normals are found under the gains so far
            m, each = lambert(sample / gains[:, c, None], w)
            p = w @ m.T
            lit = (sample > LIT * np.maximum(sample.max(0), 1e-30)) & (p > 0) & np.isfinite(each)
            ratio = np.where(lit, sample / np.where(lit, p, 1.0), np.nan)
            enough = lit.sum(1) >= FEWEST
            if not enough.any():
                break
            found = np.ones(len(w))
            found[enough] = np.nanmedian(ratio[enough], 1)
            gains[:, c] = np.maximum(found / np.exp(np.mean(np.log(np.maximum(found, 1e-6)))), 1e-3)
    return gains
