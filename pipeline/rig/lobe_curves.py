"""A pixel's fitted lobe as curves: what it sends to the camera as the half vector tilts away from its normal."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pipeline.rig.map_rendering import render_pixels

Numbers = NDArray[np.float64]
ALONG_VIEW = 0.999  # cosine of normal and view above which the view tells no direction across


def lobe_curves(
    lobe: int, view: Numbers, normal: Numbers, tangent: Numbers, sigma: Numbers, albedo: Numbers, angles: Numbers
) -> Numbers:
    """Evaluate fitted lobes under lights whose half vectors are tilted by given angles.

    Args:
        lobe: of `pipeline.rig.lobe_names`.
        view: unit, to the camera. [K, 3]
        normal: the lobe's, unit. [K, 3]
        tangent: direction of the larger width, 0 where there is none. [K, 3]
        sigma: widths, the larger first. [K, 2]
        albedo: specular. [K]
        angles: of the half vector to the normal, radians. [A]

    Returns:
        Specular radiance over irradiance, along the larger and along the smaller width (towards the camera: there the light
        stays longest above the surface); 0 where no light has that half vector. [K, 2, A]
    """
    out = np.zeros((len(view), 2, len(angles)))
    alone = np.eye(2 * len(angles), dtype=bool)  # every light by itself
    for k, (o, n) in enumerate(zip(view, normal)):
        half = _tilted(o, n, tangent[k], angles)
        light = 2 * (half @ o)[:, None] * half - o
        copies = [np.tile(v, (len(alone), 1)) for v in (o, n, n, tangent[k], sigma[k])]
        white = np.ones((len(light), 3))
        found = render_pixels(lobe, *copies, np.full(len(alone), albedo[k]), light, white, 0.0, alone)
        out[k] = found[:, 1, 0].reshape(2, -1)
    return out


def _tilted(o: Numbers, n: Numbers, tangent: Numbers, angles: Numbers) -> Numbers:
    """Half vectors [2 A, 3]: the normal tilted along its tangent, then across it."""
    t = tangent
    if not t.any():
        t = o if abs(o @ n) < ALONG_VIEW else np.eye(3)[np.argmin(np.abs(n))]
    t = t - (t @ n) * n
    t = t / max(float(np.linalg.norm(t)), 1e-9)
    tilts = [axis * (1.0 if axis @ o >= 0 else -1.0) for axis in (t, np.cross(n, t))]
    a = angles[:, None]
    return np.concatenate([np.cos(a) * n + np.sin(a) * tilt for tilt in tilts])
