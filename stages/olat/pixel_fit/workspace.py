"""The arrays that the kernels work in."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pipeline.kernels.compiling import kernel
from pipeline.kernels.scratch import folded
from stages.olat.pixel_fit.fit_options import ROWS


class Workspace(NamedTuple):
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
    trial: np.ndarray  # [2, N] weights and values of a lobe that may be dropped again
    spare: np.ndarray  # [SPARE N]


@kernel(error_model="numpy")
def make_room(n, buffer, front):
    """Workspace for `n` lights in `buffer` [ROWS n], in its precision, and `front` int64 [n]."""
    rgb, one = folded(buffer, 3, n), folded(buffer[3 * n :], 14, n)
    incident, half = folded(buffer[17 * n :], 3, n), folded(buffer[20 * n :], 3, n)
    trial, spare = folded(buffer[23 * n :], 2, n), buffer[25 * n : ROWS * n]
    return Workspace(
        rgb, one[0], one[1], one[2], one[3], one[4], one[5], one[6], one[7], front,
        one[8], one[9], one[10], one[11], one[12], one[13], incident, half, trial, spare,
    )  # fmt: skip
