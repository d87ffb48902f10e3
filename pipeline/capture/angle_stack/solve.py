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


MOST_PATTERNS_OF = 10
"""Angles up to which every pattern of invalid samples has its solver made beforehand (1024 of them)."""
WORST_CONDITION = 100.0
"""A design that is left with worse than this holds no Stokes vector: 81 for filters at 0 and 1 degree."""


class StackSolver:
    """Least squares for one design [n, 3], band by band; invalid samples get no weight."""

    def __init__(self, design: NDArray[np.float64]) -> None:
        self.design = design
        self.everywhere = np.linalg.pinv(design).astype(np.float32)
        self._patterns: tuple[NDArray[np.float32], NDArray[np.bool_]] | None = None

    def solve(
        self, samples: NDArray[np.float32], invalid: NDArray[np.bool_] | None, out: NDArray[np.float32]
    ) -> NDArray[np.bool_] | None:
        """Fill out [P, 3, C] from samples [n, P, C], invalid [n, P]; returns where too few angles are left [P], or None.

        There, all samples are used.
        """
        from pipeline.capture.angle_stack.solve_kernel import apply_solver, solve_patterns

        apply_solver(samples, self.everywhere, out)
        if invalid is None or not invalid.any():
            return None
        lost = np.zeros(samples.shape[1], bool)
        if len(self.design) <= MOST_PATTERNS_OF:
            solve_patterns(samples, invalid, *self._all_patterns(), out, lost)
        else:
            self._solve_found_patterns(samples, invalid, out, lost)
        return lost if lost.any() else None

    def _without(self, kept: NDArray[np.bool_]) -> NDArray[np.float32] | None:
        """The solver [3, n] from the kept angles alone, or None where they do not determine the vector."""
        if kept.sum() < 3 or np.linalg.cond(self.design[kept]) > WORST_CONDITION:
            return None
        solver = np.zeros((3, len(self.design)), np.float32)
        solver[:, kept] = np.linalg.pinv(self.design[kept])
        return solver

    def _all_patterns(self) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
        if self._patterns is None:
            n = len(self.design)
            solvers = np.zeros((1 << n, 3, n), np.float32)
            determined = np.zeros(1 << n, bool)
            for pattern in range(1 << n):
                solver = self._without(np.array([not pattern >> k & 1 for k in range(n)]))
                if solver is not None:
                    solvers[pattern], determined[pattern] = solver, True
            self._patterns = solvers, determined
        return self._patterns

    def _solve_found_patterns(
        self, samples: NDArray[np.float32], invalid: NDArray[np.bool_], out: NDArray[np.float32], lost: NDArray[np.bool_]
    ) -> None:
        partial = np.flatnonzero(invalid.any(0))
        keys, groups = np.unique(np.packbits(invalid[:, partial], axis=0), axis=1, return_inverse=True)
        for index in range(keys.shape[1]):
            pixels = partial[groups.ravel() == index]
            solver = self._without(~np.unpackbits(keys[:, index])[: len(self.design)].astype(bool))
            if solver is None:
                lost[pixels] = True
            else:
                out[pixels] = np.einsum("sk,kpc->psc", solver, samples[:, pixels])


def solve_stack(
    intensities: NDArray[np.float32], design: NDArray[np.float64], usable: NDArray[np.bool_] | None = None
) -> tuple[NDArray[np.float32], NDArray[np.bool_] | None]:
    """Stokes [H, W, 3, C] from intensities [n, H, W, C]; samples that are not `usable` [n, H, W] get no weight.

    Also returns where fewer than three usable angles leave the vector undetermined [H, W] (all samples are used there),
    or None if that is nowhere.
    """
    n, height, width, colours = intensities.shape
    samples = np.ascontiguousarray(intensities, np.float32).reshape(n, -1, colours)
    out = np.empty((height * width, 3, colours), np.float32)
    invalid = None if usable is None else np.ascontiguousarray(~usable.reshape(n, -1))
    lost = StackSolver(design).solve(samples, invalid, out)
    return out.reshape(height, width, 3, colours), None if lost is None else lost.reshape(height, width)
