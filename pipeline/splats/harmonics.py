"""Real spherical harmonics up to degree 3, and their rotation."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

COEFFICIENTS = 16
DEGREE = np.array([0, 1, 1, 1, 2, 2, 2, 2, 2, 3, 3, 3, 3, 3, 3, 3])
"""Of each coefficient; within a degree l the orders run from -l to l."""
CONSTANT = 0.28209479177387814
"""The harmonic of degree 0."""
PHASE = np.array([1, -1, 1, -1, 1, -1, 1, -1, 1, -1, 1, -1, 1, -1, 1, -1.0])
"""Condon and Shortley's sign (-1)^m, which the coefficients in files of 3D Gaussian splatting count with."""


def terms(x: Any, y: Any, z: Any) -> list[Any]:
    """The 16 functions, orthonormal over the sphere, without the phase.

    Args:
        x, y, z: of unit directions; arrays of any library, of one shape.

    Returns:
        By degree, and by order within it; each shaped as x.

    Source:
        Sloan, "Efficient Spherical Harmonic Evaluation", 2013.
    """
    xx, yy, zz = x * x, y * y, z * z
    return [
        0 * x + CONSTANT,
        *(0.4886025119029199 * v for v in (y, z, x)),
        1.0925484305920792 * x * y,
        1.0925484305920792 * y * z,
        0.31539156525252005 * (3 * zz - 1),
        1.0925484305920792 * x * z,
        0.5462742152960396 * (xx - yy),
        0.5900435899266435 * y * (3 * xx - yy),
        2.890611442640554 * x * y * z,
        0.4570457994644658 * y * (5 * zz - 1),
        0.3731763325901154 * z * (5 * zz - 3),
        0.4570457994644658 * x * (5 * zz - 1),
        1.445305721320277 * z * (xx - yy),
        0.5900435899266435 * x * (xx - 3 * yy),
    ]


def basis(directions: NDArray) -> NDArray[np.float64]:
    """The harmonics, with the phase.

    Args:
        directions: unit. [..., 3]

    Returns:
        Their values. [..., 16]
    """
    return np.stack(terms(*np.moveaxis(np.asarray(directions, np.float64), -1, 0)), -1) * PHASE


def turned(coefficients: NDArray, rotation: NDArray) -> NDArray[np.float64]:
    """Coefficients of turned functions: f'(R d) = f(d).

    Every degree keeps to itself: its square matrix is solved for from as many directions as make it well determined.

    Args:
        coefficients: of f. [N, 16, C]
        rotation: R, proper. [3, 3]

    Returns:
        Those of f'. [N, 16, C]
    """
    k = np.arange(4 * COEFFICIENTS) + 0.5
    z, angle = 1 - 2 * k / len(k), np.pi * (1 + np.sqrt(5)) * k
    d = np.stack([np.sqrt(1 - z * z) * np.cos(angle), np.sqrt(1 - z * z) * np.sin(angle), z], -1)
    before, after = basis(d), basis(d @ np.asarray(rotation, np.float64).T)
    out = np.empty(coefficients.shape, np.float64)
    for degree in range(4):
        own = degree == DEGREE
        matrix = np.linalg.lstsq(after[:, own], before[:, own], rcond=None)[0]
        out[:, own] = np.einsum("ij,njc->nic", matrix, coefficients[:, own])
    return out
