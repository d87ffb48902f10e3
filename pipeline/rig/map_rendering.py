"""Fitted maps under many distant lights, pixel by pixel (numba)."""

from __future__ import annotations

import math

import numpy as np
from numba import prange
from numpy.typing import NDArray

from pipeline.kernels.compiling import kernel
from pipeline.rig.lobes import values

TURNS = 6  # tangents over which a lobe without a tangent of its own is averaged


@kernel(error_model="numpy")
def _inverse_width(sigma, spread):
    return -math.log(math.sqrt(sigma * sigma + spread * spread))


@kernel(error_model="numpy", parallel=True, nogil=True)
def _render(lobe, view, normal_d, normal_s, tangent, sigma, albedo_s, directions, light, spread, visible, out):
    count, shadows = directions.shape[0], visible.shape[0] > 0
    for p in prange(view.shape[0]):
        o, n, m, used = view[p], normal_d[p], normal_s[p], 0
        incident, half, index = np.empty((3, count)), np.empty((3, count)), np.empty(count, np.int64)
        for k in range(count):
            if shadows and not visible[p, k]:
                continue
            cosine = n[0] * directions[k, 0] + n[1] * directions[k, 1] + n[2] * directions[k, 2]
            if cosine > 0:
                for c in range(3):
                    out[p, 0, c] += cosine * light[k, c]
            if m[0] * directions[k, 0] + m[1] * directions[k, 1] + m[2] * directions[k, 2] > 0:
                for j in range(3):
                    incident[j, used] = directions[k, j]
                    half[j, used] = directions[k, j] + o[j]
                size = math.sqrt(half[0, used] ** 2 + half[1, used] ** 2 + half[2, used] ** 2)
                if size > 1e-6:
                    for j in range(3):
                        half[j, used] /= size
                    index[used] = k
                    used += 1
        if not (albedo_s[p] > 0 and sigma[p, 1] > 0 and used > 0):
            continue
        frame, shape = np.empty((3, 3)), np.zeros(3)
        t = tangent[p].copy()
        turns = 1
        if t[0] * t[0] + t[1] * t[1] + t[2] * t[2] < 0.25:  # a round lobe: any tangent; several in one pixel: all of them
            turns = 1 if sigma[p, 0] == sigma[p, 1] else TURNS
            t[:] = 0.0
            t[np.argmin(np.abs(m))] = 1.0
        dot = t[0] * m[0] + t[1] * m[1] + t[2] * m[2]
        t -= dot * m
        t /= math.sqrt(t[0] * t[0] + t[1] * t[1] + t[2] * t[2])
        b = np.empty(3)
        b[0], b[1], b[2] = m[1] * t[2] - m[2] * t[1], m[2] * t[0] - m[0] * t[2], m[0] * t[1] - m[1] * t[0]
        frame[2] = m
        shape[0], shape[1] = _inverse_width(sigma[p, 0], spread), _inverse_width(sigma[p, 1], spread)
        one, lobes = np.empty(used), np.zeros(used)
        h = (half[0, :used], half[1, :used], half[2, :used])
        i = (incident[0, :used], incident[1, :used], incident[2, :used])
        for turn in range(turns):
            along, across = math.cos(turn * math.pi / turns), math.sin(turn * math.pi / turns)
            frame[0], frame[1] = along * t + across * b, along * b - across * t
            values(lobe, frame, shape, o, h, i, one)
            lobes += one / turns
        for j in range(used):
            g = albedo_s[p] * lobes[j]
            for channel in range(3):
                out[p, 1, channel] += g * light[index[j], channel]


def render_pixels(
    lobe: int,
    view: NDArray[np.float64],
    normal_d: NDArray[np.float64],
    normal_s: NDArray[np.float64],
    tangent: NDArray[np.float64],
    sigma: NDArray[np.float64],
    albedo_s: NDArray[np.float64],
    directions: NDArray[np.float64],
    light: NDArray[np.float64],
    spread: float,
    visible: NDArray[np.bool_] | None = None,
) -> NDArray[np.float64]:
    """Irradiance and specular radiance [P, 2, 3] of P pixels under M lights.

    view, normals, tangent [P, 3]; sigma [P, 2] (larger first, along the tangent; averaged over tangents where
    that is 0); albedo_s [P]; directions [M, 3]; light
    [M, 3]: irradiance; spread (rad): added to the widths in quadrature; visible [P, M]: which lights reach which pixel (all).
    """
    out = np.zeros((len(view), 2, 3))
    reaches = np.zeros((0, 0), np.bool_) if visible is None else np.ascontiguousarray(visible, np.bool_)
    _render(lobe, view, normal_d, normal_s, tangent, sigma, albedo_s, directions, light, spread, reaches, out)
    return out
