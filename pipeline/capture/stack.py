"""Stokes vectors from intensities behind a polariser at known angles: weighted least squares (PhyGaP Eq. 31, row 0)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray


def polariser_design(angles_deg: Sequence[float], extinction: float | None = None) -> NDArray[np.float64]:
    """Rows of I = row · (s0, s1, s2) for each angle (degrees, counter-clockwise), [n, 3].

    An ideal polariser passes (1, cos 2t, sin 2t) / 2; one of extinction ratio e passes 1/e of the blocked light too.
    """
    t = 2 * np.radians(np.asarray(angles_deg, float))
    leak = 0.0 if extinction is None else 1.0 / extinction
    ones = np.full_like(t, 1 + leak)
    return 0.5 * np.stack([ones, (1 - leak) * np.cos(t), (1 - leak) * np.sin(t)], axis=1)


def design_covariance(design: NDArray[np.float64]) -> NDArray[np.float64]:
    """Covariance [3, 3] of the least-squares (s0, s1, s2) for samples of unit variance."""
    return np.asarray(np.linalg.pinv(design.T @ design), np.float64)


def solve_stack(
    intensities: NDArray[np.float32], design: NDArray[np.float64], usable: NDArray[np.bool_] | None = None
) -> tuple[NDArray[np.float32], NDArray[np.bool_] | None]:
    """Stokes [H, W, 3, C] from intensities [n, H, W, C]; samples that are not `usable` [n, H, W] get no weight.

    Also returns where fewer than three usable angles leave the vector undetermined [H, W] (all samples are used there),
    or None if that is nowhere.
    """
    n, height, width, colours = intensities.shape
    from pipeline.capture.stack_kernel import apply_solver

    samples = np.ascontiguousarray(intensities, np.float32).reshape(n, -1, colours)
    out = apply_solver(samples, np.linalg.pinv(design).astype(np.float32))
    lost = None
    if usable is not None and not usable.all():
        lost = np.zeros(height * width, bool)
        partial = np.flatnonzero(~usable.all(0).ravel())
        # Pixels with the same usable angles share one solver: at most 2^n of them.
        patterns = np.packbits(usable.reshape(n, -1)[:, partial], axis=0)
        keys, groups = np.unique(patterns, axis=1, return_inverse=True)
        for index in range(keys.shape[1]):
            pixels = partial[groups.ravel() == index]
            kept = np.unpackbits(keys[:, index])[:n].astype(bool)
            if kept.sum() < 3 or np.linalg.cond(design[kept]) > 100:
                lost[pixels] = True
                continue
            some = np.linalg.pinv(design[kept]).astype(np.float32)
            out[pixels] = np.einsum("sk,kpc->psc", some, samples[kept][:, pixels])
        lost = lost.reshape(height, width) if lost.any() else None
    return out.reshape(height, width, 3, colours), lost
