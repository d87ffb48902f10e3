"""Where formulas go wrong: the stiff places of each argument, and random points between them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Points = NDArray[np.float64]

RANDOM = 400
COSINES = (
    1.0,
    1 - 1e-7,
    float(np.cos(1e-4)),
    float(np.cos(1e-2)),
    0.866,
    0.5,
    0.1,
    float(np.cos(np.radians(89.99))),
    1e-5,
    2e-6,
)
IORS = (1.0, 1 + 1e-7, 1 + 1e-4, 1.001, 1.3, 1.5, 2.0, 2.3, 2.6)
ALPHAS = (1e-6, 1e-4, 0.0064, 0.05, 0.3, 1.0)
BESIDE_BREWSTER = (0.0, 1e-6, -1e-6, 1e-4, -1e-4, 1e-2, -1e-2)  # rad
ANGLES = (0.0, 1e-7, -1e-7, np.pi / 8, np.pi / 4, np.pi / 2, -np.pi / 2, np.pi, 2.0, -3.0, 6.0)
LENGTHS = (0.0, 1e-37, 1e-30, 1e-10, 1.0, 1e10, 1e30)
"""Stokes vectors from underflowing to overflowing squares."""


def product(*axes: Sequence[float]) -> Points:
    """Every combination of the axes' values [N, len(axes)]."""
    return np.stack([x.ravel() for x in np.meshgrid(*axes, indexing="ij")], -1)


def cosine_and_ior() -> Points:
    """(c, eta) [N, 2]: the stiff grid, Brewster's angle and beside it, and random points."""
    brewster = [(float(np.cos(np.arctan(eta) + d)), eta) for eta in IORS for d in BESIDE_BREWSTER]
    rng = np.random.default_rng(0)
    random = np.stack((rng.uniform(2e-6, 1, RANDOM), rng.uniform(1, 2.6, RANDOM)), -1)
    return np.concatenate((product(COSINES, IORS), np.array(brewster), random))


def with_sine(points: Points) -> Points:
    """(c, sin^2, eta): the squared sine as the projected normal gives it, an argument of its own."""
    c = points[:, 0]
    return np.stack((c, (1 - c) * (1 + c), points[:, 1]), -1)


def ior() -> Points:
    """eta [N, 1]."""
    return np.concatenate((np.array(IORS), np.random.default_rng(1).uniform(1, 2.6, RANDOM)))[:, None]


def cosine_and_alpha() -> Points:
    """(c, alpha) [N, 2]."""
    rng = np.random.default_rng(2)
    random = np.stack((rng.uniform(2e-6, 1, RANDOM), 10 ** rng.uniform(-6, 0, RANDOM)), -1)
    return np.concatenate((product(COSINES, ALPHAS), random))


def two_cosines_and_alpha() -> Points:
    """(n.v, n.l, alpha) [N, 3]."""
    rng = np.random.default_rng(3)
    random = np.concatenate((rng.uniform(2e-6, 1, (RANDOM, 2)), 10 ** rng.uniform(-6, 0, (RANDOM, 1))), -1)
    return np.concatenate((product(COSINES[::2], COSINES[::2], ALPHAS), random))


def stokes() -> Points:
    """(s0, s1, s2) [N, 3]: lengths from 1e-37 to 1e30, unpolarised, fully polarised and beyond."""
    shares = ((1.0, 0.0, 0.0), (1.0, 1.0, 0.0), (1.0, 0.0, -1.0), (1.0, 0.3, 0.4), (1.0, -1e-6, 1e-6), (1.0, 0.9, 0.9))
    stiff = np.array([(a * length, b * length, c * length) for a, b, c in shares for length in LENGTHS])
    random = np.random.default_rng(4).uniform(-1, 1, (RANDOM, 3)) + np.array([1.01, 0.0, 0.0])
    return np.concatenate((stiff, random))


def angles() -> Points:
    """One angle (rad) [N, 1]."""
    return np.concatenate((np.array(ANGLES), np.random.default_rng(5).uniform(-4, 4, RANDOM)))[:, None]


def two_angles() -> Points:
    """Two angles (rad) [N, 2]."""
    return np.concatenate((product(ANGLES, ANGLES), np.random.default_rng(6).uniform(-4, 4, (RANDOM, 2))))


def angle_and_extinction() -> Points:
    """(theta, extinction ratio) [N, 2]: from hardly a polariser to an ideal one."""
    rng = np.random.default_rng(7)
    random = np.stack((rng.uniform(-4, 4, RANDOM), 10 ** rng.uniform(0, 8, RANDOM)), -1)
    return np.concatenate((product(ANGLES, (1.0, 1 + 1e-6, 10.0, 1e4, 1e12, float("inf"))), random))


def projections() -> Points:
    """A normal's projection on a pixel's frame, (n.x, n.y) [N, 2]."""
    values = (0.0, 1e-30, -1e-7, 1e-4, 0.5, -0.5, 0.70710677, 1.0)
    return np.concatenate((product(values, values), np.random.default_rng(8).uniform(-0.7, 0.7, (RANDOM, 2))))
