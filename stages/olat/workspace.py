"""What the kernels need to know, and the arrays they work in."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit


class Settings(NamedTuple):
    """What the kernels need to know; plain numbers, so that numba can take it."""

    lobe: int
    rounds: int  # reweighting rounds of the diffuse fit
    robust: int  # reweighting rounds of the specular fit (0: plain least squares)
    steps: int  # Levenberg-Marquardt steps at the end
    tolerance: float  # gradient norm, data of unit norm, at which a fit ends
    saturation: float  # radiance from which a sample is clipped (inf: none is)
    specular_factor: float
    irradiance: float
    gain: float  # share of the round lobe's robust cost that an anisotropic one must beat
    mixed: float  # share of one lobe's robust cost that mixed tangents must beat (0: never tried)
    prior: float  # strength of the tie of n_s to n_d: inverse square of the angle (rad) they may differ by
    plain: bool  # diffuse fit without robust weights (PRF Eq. 12)
    specular_fit: int  # how n_s is found, `paper.SPECULAR_FITS`
    fuse_correlation: bool  # fuse the normals by correlation (PRF) instead of inverse variance
    printed_maps: bool  # occlusion and inter-reflection as PRF Eqs. 4 and 5 print them
    remove: bool  # clipped samples by PRF Algorithm 1 instead of as bounds
    gradient: bool  # gradient illumination alone (Ma et al. 2007)


class Room(NamedTuple):
    """Workspace of one thread for pixels with N lights."""

    rgb: np.ndarray  # [3, N] I_d in albedo units
    diffuse: np.ndarray  # [N] their mean
    specular: np.ndarray  # [N] I_s per unit irradiance
    ok: np.ndarray
    use: np.ndarray
    floor: np.ndarray
    weight: np.ndarray
    work: np.ndarray
    scratch: np.ndarray
    front: np.ndarray  # [N] indices of the lights before the surface
    light: np.ndarray  # [N] and below: the same lights' samples, packed
    area: np.ndarray
    cosine: np.ndarray
    seen: np.ndarray
    bound: np.ndarray
    lobe: np.ndarray
    incident: np.ndarray  # [3, N]
    half: np.ndarray  # [3, N]


@njit(cache=True, error_model="numpy")
def make_room(n, like):
    """Workspace for `n` lights in the precision of the array `like`."""
    one = np.zeros((14, n), like.dtype)
    return Room(
        np.zeros((3, n), like.dtype), one[0], one[1], one[2], one[3], one[4], one[5], one[6], one[7],
        np.zeros(n, np.int64), one[8], one[9], one[10], one[11], one[12], one[13],
        np.zeros((3, n), like.dtype), np.zeros((3, n), like.dtype),
    )  # fmt: skip
