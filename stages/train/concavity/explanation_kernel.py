"""The search for the normal and albedo that explain a point's views best: numba, float32, all cores.

A view's prediction is albedo * body + gloss in up to nine values; the albedo that fits best follows from each normal in
closed form, and the normal is tried out: a grid of directions, then three rounds of ever smaller steps.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from pipeline.kernels.compiling import kernel
from pipeline.kernels.simd import take_ticket

from ..octahedral_map import octahedral_texel

LEAST_COSINE = 0.03  # below it a normal turns the surface away from a view that sees it
WORST = np.float32(0.3)  # encoded residual at which a view counts as wholly unexplained: a shadow, another surface in front
WIDTH = np.float32(0.01)  # encoded residual below which the penalty is quadratic, as in the losses
PRIOR = np.float32(1e-3)  # weight of the albedo so far, per squared encoded residual: decides where hardly anything is lit
FACING_SHARE = 0.7  # share of the views that a normal must face to be tried
CHUNK = 16  # points a ticket
# Power of the unblocked share of a view's reflection as its weight: what the object mirrors of itself is known least, and
# fakes hollows beside spouts and handles.
UNBLOCKED = 2


@kernel(nogil=True, fastmath=True, error_model="numpy")
def _predict(nx, ny, nz, count, towards, axis_x, axis_y, mix, own, trust, irradiance, mirrored, angular, body, gloss, weight):
    """Every view's body and gloss [C, V] for one normal; weight [V] is 0 where it turns away. Returns the weight so lost."""
    size, channels = len(irradiance), len(body)
    last = np.float32(len(angular) - 1)
    start, per = np.float32(LEAST_COSINE), np.float32(1 / (1 - LEAST_COSINE))
    two = np.float32(2)
    i, j = octahedral_texel(nx, ny, nz, size)
    received0, received1, received2 = irradiance[i, j, 0], irradiance[i, j, 1], irradiance[i, j, 2]
    lost = np.float32(0)
    for k in range(count):
        vx, vy, vz = towards[k, 0], towards[k, 1], towards[k, 2]
        c = nx * vx + ny * vy + nz * vz
        if c < start:
            weight[k] = np.float32(0)
            lost += trust[k]
            for t in range(channels):
                body[t, k] = gloss[t, k] = np.float32(0)
            continue
        weight[k] = trust[k]
        q = min(int((c - start) * per * last + np.float32(0.5)), len(angular) - 1)
        x = nx * axis_x[k, 0] + ny * axis_x[k, 1] + nz * axis_x[k, 2]
        y = nx * axis_y[k, 0] + ny * axis_y[k, 1] + nz * axis_y[k, 2]
        cos2, sin2 = x * x - y * y, two * x * y
        i, j = octahedral_texel(two * c * nx - vx, two * c * ny - vy, two * c * nz - vz, size)
        out, polarised, rho, across = angular[q, 0], angular[q, 1], angular[q, 2], -angular[q, 3]
        d0 = out * (own[k, 0] * received0 + own[k, 3])
        d1 = out * (own[k, 1] * received1 + own[k, 4])
        d2 = out * (own[k, 2] * received2 + own[k, 5])
        g0 = rho * (own[k, 9] * mirrored[i, j, 0] + own[k, 6])
        g1 = rho * (own[k, 9] * mirrored[i, j, 1] + own[k, 7])
        g2 = rho * (own[k, 9] * mirrored[i, j, 2] + own[k, 8])
        if channels == 9:
            body[0, k], body[1, k], body[2, k] = d0, d1, d2
            gloss[0, k], gloss[1, k], gloss[2, k] = g0, g1, g2
            p, s = polarised * cos2, across * cos2
            body[3, k], body[4, k], body[5, k] = p * d0, p * d1, p * d2
            gloss[3, k], gloss[4, k], gloss[5, k] = s * g0, s * g1, s * g2
            p, s = polarised * sin2, across * sin2
            body[6, k], body[7, k], body[8, k] = p * d0, p * d1, p * d2
            gloss[6, k], gloss[7, k], gloss[8, k] = s * g0, s * g1, s * g2
        else:
            turn = mix[k, 0] * cos2 + mix[k, 1] * sin2
            p, s = np.float32(1) + polarised * turn, np.float32(1) + across * turn
            body[0, k], body[1, k], body[2, k] = p * d0, p * d1, p * d2
            gloss[0, k], gloss[1, k], gloss[2, k] = s * g0, s * g1, s * g2
    return lost


@kernel(nogil=True, fastmath=True, error_model="numpy")
def _residual(count, values, slope, prior, body, gloss, weight, lost, albedo, sums):
    """Weighted mean robust residual of one normal's predictions at the albedo that fits them best."""
    channels = len(body)
    for channel in range(3):
        top, bottom = PRIOR * prior[channel], PRIOR
        for t in range(channel, channels, 3):
            for k in range(count):
                pull = weight[k] * slope[t, k] * slope[t, k] * body[t, k]
                top += pull * (values[t, k] - gloss[t, k])
                bottom += pull * body[t, k]
        albedo[channel] = min(max(top / bottom, np.float32(0)), np.float32(1))
    for k in range(count):
        sums[k] = np.float32(0)
    for t in range(channels):
        a = albedo[t % 3]
        for k in range(count):
            e = slope[t, k] * (a * body[t, k] + gloss[t, k] - values[t, k])
            sums[k] += np.float32(math.sqrt(e * e + WIDTH * WIDTH)) - WIDTH
    total, whole = WORST * lost, lost
    third = np.float32(1 / 3)
    for k in range(count):
        total += weight[k] * min(third * sums[k], WORST)
        whole += weight[k]
    return total / max(whole, np.float32(1e-6))  # every view wholly blocked: nothing is known, and 0 / 0 must not say so


class _Point(NamedTuple):
    """What V views saw of one point, as in `Observations`; values and slope turned to [C, V]; trust [V] in each view."""

    views: int
    values: np.ndarray
    slope: np.ndarray
    towards: np.ndarray
    axis_x: np.ndarray
    axis_y: np.ndarray
    mix: np.ndarray
    own: np.ndarray
    trust: np.ndarray
    albedo: np.ndarray  # [3] what to fall back on


class _Workspace(NamedTuple):
    """Scratch of one thread: body and gloss [C, V], weight and sums [V], albedo [3]."""

    body: np.ndarray
    gloss: np.ndarray
    weight: np.ndarray
    sums: np.ndarray
    albedo: np.ndarray


@kernel(nogil=True, fastmath=True, error_model="numpy")
def _best_of(normals, point, light, work):
    """Least residual over the normals [M, 3] that enough of the views face, and which it is; infinity and -1 for none."""
    count, values, slope, v, fx, fy, mix, own, trust, prior = point  # taken apart once: a field's every use counts references
    irradiance, mirrored, angular = light
    body, gloss, weight, sums, albedo = work
    least, chosen = np.float32(np.inf), -1
    for m in range(len(normals)):
        nx, ny, nz = normals[m, 0], normals[m, 1], normals[m, 2]
        facing = 0
        for k in range(count):
            facing += nx * v[k, 0] + ny * v[k, 1] + nz * v[k, 2] > np.float32(LEAST_COSINE)
        if facing < FACING_SHARE * count:
            continue
        lost = _predict(
            nx, ny, nz, count, v, fx, fy, mix, own, trust, irradiance, mirrored, angular, body, gloss, weight
        )  # fmt: skip
        r = _residual(count, values, slope, prior, body, gloss, weight, lost, albedo, sums)
        if r < least:
            least, chosen = r, m
    return least, chosen


@kernel(nogil=True, fastmath=True, error_model="numpy")
def _refined(nx, ny, nz, least, point, light, work):
    """Least residual after three rounds of six ever smaller steps about the normal."""
    count, values, slope, v, fx, fy, mix, own, trust, prior = point  # taken apart once: a field's every use counts references
    irradiance, mirrored, angular = light
    body, gloss, weight, sums, albedo = work
    for level in range(3):
        step = np.float32(0.1 / 2**level)
        if abs(nx) < np.float32(0.6):
            ux, uy, uz = np.float32(0), nz, -ny
        else:
            ux, uy, uz = -nz, np.float32(0), nx
        length = np.float32(1 / math.sqrt(ux * ux + uy * uy + uz * uz))
        ux, uy, uz = ux * length, uy * length, uz * length
        wx, wy, wz = ny * uz - nz * uy, nz * ux - nx * uz, nx * uy - ny * ux
        bx, by, bz = nx, ny, nz
        for k in range(6):
            a, b = step * np.float32(math.cos(k * math.pi / 3)), step * np.float32(math.sin(k * math.pi / 3))
            qx, qy, qz = nx + a * ux + b * wx, ny + a * uy + b * wy, nz + a * uz + b * wz
            length = np.float32(1 / math.sqrt(qx * qx + qy * qy + qz * qz))
            qx, qy, qz = qx * length, qy * length, qz * length
            lost = _predict(
                qx, qy, qz, count, v, fx, fy, mix, own, trust, irradiance, mirrored, angular, body, gloss, weight
            )  # fmt: skip
            r = _residual(count, values, slope, prior, body, gloss, weight, lost, albedo, sums)
            if r < least:
                least = r
                bx, by, bz = qx, qy, qz
        nx, ny, nz = bx, by, bz
    return least


@kernel(nogil=True, fastmath=True, error_model="numpy")
def explain(counters, seen, light, normals, prior, best):
    """Each of P points' least residual over normals and albedos, as one thread's share of the tickets.

    Args:
        counters: tickets, int64. [2]
        seen: what the views saw, `samples.Observations`.
        light: tables, `explanation.Shading`.
        normals: directions that are tried first. [M, 3]
        prior: albedo to fall back on. [P, 3]
        best: filled; what no view sees keeps its value. [P]
    """
    most, channels = seen.values.shape[1], seen.values.shape[2]
    work = _Workspace(
        np.empty((channels, most), np.float32), np.empty((channels, most), np.float32),
        np.empty(most, np.float32), np.empty(most, np.float32), np.empty(3, np.float32),
    )  # fmt: skip
    values, slope = np.empty((channels, most), np.float32), np.empty((channels, most), np.float32)
    trust = np.empty(most, np.float32)
    while True:
        first = take_ticket(counters, 0) * CHUNK
        if first >= len(best):
            return
        for p in range(first, min(first + CHUNK, len(best))):
            count, own = seen.views[p], seen.own[p]
            if count == 0:
                continue
            for k in range(count):
                trust[k] = own[k, 9] ** UNBLOCKED
                for t in range(channels):
                    values[t, k], slope[t, k] = seen.values[p, k, t], seen.slope[p, k, t % 3]
            point = _Point(
                count, values, slope, seen.towards[p], seen.frame_x[p], seen.frame_y[p], seen.mix[p], own, trust, prior[p]
            )
            least, chosen = _best_of(normals, point, light, work)
            if chosen >= 0:
                n = normals[chosen]
                best[p] = _refined(n[0], n[1], n[2], least, point, light, work)
