"""Gaussians with colour by direction."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from . import harmonics

Array = NDArray[np.float64]


@dataclass(frozen=True)
class SplatCloud:
    """N Gaussians as 3D Gaussian splatting has them (Kerbl et al. 2023).

    Fields:
        means: centres, world units. [N, 3]
        quaternions: wxyz, unit. [N, 4]
        log_scales: natural logarithms of sigma along the axes that the quaternion turns. [N, 3]
        opacity: logit of the peak opacity. [N]
        coefficients: of spherical harmonics (`harmonics.basis`) in the direction from the camera to the Gaussian:
            colour = 0.5 + sum, negative ones 0, sRGB-encoded. [N, 16, 3]
    """

    means: Array
    quaternions: Array
    log_scales: Array
    opacity: Array
    coefficients: Array

    def __len__(self) -> int:
        return len(self.means)

    def colours(self, centre: NDArray) -> Array:
        """sRGB colours [N, 3] as a camera at `centre` [3] sees them; not limited to 1."""
        towards = self.means - centre
        towards = towards / np.maximum(np.linalg.norm(towards, axis=1, keepdims=True), 1e-12)
        return np.maximum(0.5 + np.einsum("nk,nkc->nc", harmonics.basis(towards), self.coefficients), 0)

    def turned(self, rotation: NDArray, scale: float = 1.0) -> SplatCloud:
        """The same object in a frame x' = scale R x (a proper rotation)."""
        return replace(
            self,
            means=scale * self.means @ rotation.T,
            quaternions=turned_quaternions(self.quaternions, rotation),
            log_scales=self.log_scales + np.log(scale),
            coefficients=harmonics.turned(self.coefficients, rotation),
        )


def turned_quaternions(quaternions: NDArray, rotation: NDArray) -> Array:
    """Orientations after a world rotation.

    Args:
        quaternions: wxyz, of any length. [N, 4]
        rotation: proper. [3, 3]

    Returns:
        wxyz, unit, w >= 0. [N, 4]

    Raises:
        ValueError: the rotation is a reflection.
    """
    from scipy.spatial.transform import Rotation

    if np.linalg.det(rotation) < 0:
        raise ValueError("a reflection is not a rotation")
    if not len(quaternions):
        return np.zeros((0, 4))
    q = (Rotation.from_matrix(rotation) * Rotation.from_quat(quaternions, scalar_first=True)).as_quat(scalar_first=True)
    return np.where(q[:, :1] < 0, -q, q)
