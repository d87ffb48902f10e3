"""Numba: splats to screen, forward and backward. One record of GEO float32 per splat; formulas as in `reference`."""

from __future__ import annotations

import math

import numpy as np

from pipeline.kernels.compiling import kernel
from pipeline.kernels.simd import LANES, TILE, load, spread, store, take_ticket

from . import constants as k

# columns of the projected record: derivatives of u, v, q by pixel, centre, camera z, opacity, z / near, box, state
UX, UY, VX, VY, QX, QY, CX, CY, Z, OPACITY, Q_MAX, LEFT, RIGHT, TOP, BOTTOM, STATE = range(16)
GEO = 16
CULLED, SOLID, FLAT = 0.0, 1.0, 2.0  # STATE; FLAT: edge-on, screen-space kernel only

# columns of a gradient record, before the attributes: by the record's columns, then sums of |dL/d centre|
G_UX, G_UY, G_VX, G_VY, G_QX, G_QY, G_CX, G_CY, G_Z, G_OPACITY, G_ABS_X, G_ABS_Y = range(12)
G_GEO = 12

CHUNK = 512  # splats a thread takes at a time

_f = np.float32
ALPHA_MIN = _f(k.ALPHA_MIN)
CUTOFF_RHO = _f(k.CUTOFF_RHO)
MIN_COSINE = _f(k.MIN_COSINE)
MIN_SIGMA_PX = _f(k.MIN_SIGMA_PX)
HALF_ANGLE = _f(k.MAX_HALF_ANGLE_FRACTION)
MARGIN = _f(k.BOUNDS_MARGIN_PX)
INFINITY = _f(np.inf)
ZERO, HALF = _f(0), _f(0.5)


@kernel(nogil=True, error_model="numpy", allocates=False)
def unit_quaternion(q: np.ndarray) -> tuple:
    """Normalised wxyz and 1 / norm; divided by the largest entry first, so that squares neither vanish nor overflow."""
    largest = max(max(abs(q[0]), abs(q[1])), max(abs(q[2]), abs(q[3])))
    w, x, y, z = q[0] / largest, q[1] / largest, q[2] / largest, q[3] / largest
    inverse = _f(1) / math.sqrt(w * w + x * x + y * y + z * z)
    return w * inverse, x * inverse, y * inverse, z * inverse, inverse / largest


@kernel(nogil=True, error_model="numpy", allocates=False)
def camera_axes(q: np.ndarray, R: np.ndarray) -> tuple:
    """Columns t_u, t_v, n of the splat's rotation in camera axes (9 numbers), and n in world axes (3)."""
    w, x, y, z, _ = unit_quaternion(q)
    two = _f(2)
    ux, uy, uz = _f(1) - two * (y * y + z * z), two * (x * y + w * z), two * (x * z - w * y)
    vx, vy, vz = two * (x * y - w * z), _f(1) - two * (x * x + z * z), two * (y * z + w * x)
    nx, ny, nz = two * (x * z + w * y), two * (y * z - w * x), _f(1) - two * (x * x + y * y)
    return (
        R[0, 0] * ux + R[0, 1] * uy + R[0, 2] * uz,
        R[1, 0] * ux + R[1, 1] * uy + R[1, 2] * uz,
        R[2, 0] * ux + R[2, 1] * uy + R[2, 2] * uz,
        R[0, 0] * vx + R[0, 1] * vy + R[0, 2] * vz,
        R[1, 0] * vx + R[1, 1] * vy + R[1, 2] * vz,
        R[2, 0] * vx + R[2, 1] * vy + R[2, 2] * vz,
        R[0, 0] * nx + R[0, 1] * ny + R[0, 2] * nz,
        R[1, 0] * nx + R[1, 1] * ny + R[1, 2] * nz,
        R[2, 0] * nx + R[2, 1] * ny + R[2, 2] * nz,
        nx,
        ny,
        nz,
    )


@kernel(nogil=True, error_model="numpy", allocates=False)
def outline(X: float, z: float, ux: float, uz: float, vx: float, vz: float, r2: float) -> tuple:
    """Interval of x / focal, relative to the centre, that the cut-off circle covers (`reference.bounds`)."""
    eu, ev = ux - X * uz, vx - X * vz
    dd, ed, ee = r2 * (uz * uz + vz * vz), r2 * (eu * uz + ev * vz), r2 * (eu * eu + ev * ev)
    if math.sqrt(dd) > HALF_ANGLE * z:
        return -INFINITY, INFINITY
    leading = dd - z * z
    inside = ed * ed - leading * ee
    spread = math.sqrt(inside) if inside > 0 else ZERO
    return (ed + spread) / leading, (ed - spread) / leading


@kernel(nogil=True, error_model="numpy", allocates=False)
def tile_range(low: float, high: float, size: int) -> tuple:
    """First and last + 1 tile whose pixel centres (at +0.5) can lie in [low, high]; empty where none does."""
    first = max(low - HALF, ZERO)
    last = min(high - HALF, _f(size - 1))
    if not last >= first:
        return 0, 0
    pixel = int(first)
    pixel += int(pixel < first)  # rounded up; both are >= 0
    return pixel // TILE, int(last) // TILE + 1


@kernel(nogil=True, error_model="numpy", allocates=False)
def project(
    counters: np.ndarray,
    means: np.ndarray,
    quats: np.ndarray,
    scales: np.ndarray,
    opacities: np.ndarray,
    features: np.ndarray,
    camera: np.ndarray,
    lens: np.ndarray,
    near: float,
    screen: float,
    width: int,
    height: int,
    geo: np.ndarray,
    attributes: np.ndarray,
    box: np.ndarray,
    radii: np.ndarray,
) -> None:
    """Project every splat; lens is fx, fy, cx, cy; screen: the low-pass filter's inverse variance, infinity for none.

    Fills geo [N, GEO]; attributes [N, A >= C + 3]: features, normal towards the camera, zeros; box [N, 4]: the tiles it can
    touch; radii [N]: half the larger side of its bounding box, at most the image's, 0 where it cannot be seen.
    """
    fx, fy = lens[0], lens[1]
    count, channels = len(means), features.shape[1]
    while True:
        start = take_ticket(counters, 0) * CHUNK
        if start >= count:
            return
        for s in range(start, min(start + CHUNK, count)):
            g = geo[s]
            g[STATE] = CULLED
            box[s, 0] = box[s, 1] = box[s, 2] = box[s, 3] = 0
            radii[s] = ZERO
            m, q = means[s], quats[s]
            su, sv, opacity = scales[s, 0], scales[s, 1], opacities[s]
            z = camera[2, 0] * m[0] + camera[2, 1] * m[1] + camera[2, 2] * m[2] + camera[2, 3]
            if not (z >= near and z < INFINITY and opacity >= ALPHA_MIN and opacity < INFINITY):
                continue
            if not (su > 0 and sv > 0 and su < INFINITY and sv < INFINITY):
                continue
            norm = abs(q[0]) + abs(q[1]) + abs(q[2]) + abs(q[3])
            if not (norm > 0 and norm < INFINITY):
                continue
            X = (camera[0, 0] * m[0] + camera[0, 1] * m[1] + camera[0, 2] * m[2] + camera[0, 3]) / z
            Y = (camera[1, 0] * m[0] + camera[1, 1] * m[1] + camera[1, 2] * m[2] + camera[1, 3]) / z
            if not (abs(X) < INFINITY and abs(Y) < INFINITY):
                continue
            tux, tuy, tuz, tvx, tvy, tvz, nx, ny, nz, wx, wy, wz = camera_axes(q, camera)
            floor = MIN_SIGMA_PX * (z / max(fx, fy))
            su, sv = max(su, floor), max(sv, floor)
            facing = nx * X + ny * Y + nz
            flat = abs(facing) < MIN_COSINE * math.sqrt(X * X + Y * Y + _f(1))
            r2 = min(CUTOFF_RHO, _f(2) * math.log(min(opacity, _f(1)) / ALPHA_MIN))
            left = right = top = bottom = _f(0)
            if flat:
                g[UX] = g[UY] = g[VX] = g[VY] = g[QX] = g[QY] = ZERO
            else:
                a = z / (su * facing)
                b = z / (sv * facing)
                g[UX], g[UY] = a * (tvy - tvz * Y) / fx, a * (tvz * X - tvx) / fy
                g[VX], g[VY] = b * (Y * tuz - tuy) / fx, b * (tux - X * tuz) / fy
                g[QX], g[QY] = nx / (facing * fx), ny / (facing * fy)
                left, right = outline(X, z, su * tux, su * tuz, sv * tvx, sv * tvz, r2)
                top, bottom = outline(Y, z, su * tuy, su * tuz, sv * tvy, sv * tvz, r2)
            radius = math.sqrt(r2 / screen)
            g[CX], g[CY] = fx * X + lens[2], fy * Y + lens[3]
            g[LEFT], g[RIGHT] = g[CX] + min(fx * left, -radius) - MARGIN, g[CX] + max(fx * right, radius) + MARGIN
            g[TOP], g[BOTTOM] = g[CY] + min(fy * top, -radius) - MARGIN, g[CY] + max(fy * bottom, radius) + MARGIN
            g[Z], g[OPACITY], g[Q_MAX] = z, opacity, z / near
            g[STATE] = FLAT if flat else SOLID
            box[s, 0], box[s, 1] = tile_range(g[LEFT], g[RIGHT], width)
            box[s, 2], box[s, 3] = tile_range(g[TOP], g[BOTTOM], height)
            if g[RIGHT] > 0 and g[LEFT] < width and g[BOTTOM] > 0 and g[TOP] < height:
                radii[s] = min(HALF * max(g[RIGHT] - g[LEFT], g[BOTTOM] - g[TOP]), _f(max(width, height)))
            for c in range(channels):
                attributes[s, c] = features[s, c]
            sign = _f(-1) if facing > 0 else _f(1)
            attributes[s, channels] = sign * wx
            attributes[s, channels + 1] = sign * wy
            attributes[s, channels + 2] = sign * wz
            for c in range(channels + 3, attributes.shape[1]):
                attributes[s, c] = ZERO


@kernel(nogil=True, error_model="numpy", allocates=False)
def project_backward(
    counters: np.ndarray,
    means: np.ndarray,
    quats: np.ndarray,
    scales: np.ndarray,
    camera: np.ndarray,
    lens: np.ndarray,
    geo: np.ndarray,
    slot_start: np.ndarray,
    slots: np.ndarray,
    d_means: np.ndarray,
    d_quats: np.ndarray,
    d_scales: np.ndarray,
    d_opacities: np.ndarray,
    d_features: np.ndarray,
    screen_gradient: np.ndarray,
    workspace: np.ndarray,
) -> None:
    """Sum each splat's gradient records (slots [S, multiple of LANES], in a fixed order) and chain them to the inputs."""
    fx, fy = lens[0], lens[1]
    count, channels = len(means), d_features.shape[1]
    width = slots.shape[1]
    total = workspace[take_ticket(counters, 1)]
    R = camera
    while True:
        start = take_ticket(counters, 0) * CHUNK
        if start >= count:
            return
        for s in range(start, min(start + CHUNK, count)):
            if slot_start[s] == slot_start[s + 1]:
                continue
            for c in range(0, width, LANES):
                store(total, c, spread(0))
            for slot in range(slot_start[s], slot_start[s + 1]):
                for c in range(0, width, LANES):
                    store(total, c, load(total, c) + load(slots, slot * width + c))
            d_opacities[s] = total[G_OPACITY]
            screen_gradient[s] = math.sqrt(total[G_ABS_X] ** 2 + total[G_ABS_Y] ** 2)
            for c in range(channels):
                d_features[s, c] = total[G_GEO + c]
            g, m, q = geo[s], means[s], quats[s]
            z = g[Z]
            X = (R[0, 0] * m[0] + R[0, 1] * m[1] + R[0, 2] * m[2] + R[0, 3]) / z
            Y = (R[1, 0] * m[0] + R[1, 1] * m[1] + R[1, 2] * m[2] + R[1, 3]) / z
            _, _, tuz, _, _, tvz, nx, ny, nz, _, _, _ = camera_axes(q, R)
            facing = nx * X + ny * Y + nz
            dX, dY, dz = fx * total[G_CX], fy * total[G_CY], total[G_Z]
            dtux = dtuy = dtuz = dtvx = dtvy = dtvz = dnx = dny = dnz = _f(0)
            if g[STATE] == SOLID:
                floor = MIN_SIGMA_PX * (z / max(fx, fy))
                su, sv = max(scales[s, 0], floor), max(scales[s, 1], floor)
                d_a = total[G_UX] * g[UX] + total[G_UY] * g[UY]  # by log of a = z / (su facing)
                d_b = total[G_VX] * g[VX] + total[G_VY] * g[VY]
                d_q = total[G_QX] * g[QX] + total[G_QY] * g[QY]
                if scales[s, 0] >= floor:
                    d_scales[s, 0] = -d_a / su
                    dz += d_a / z
                if scales[s, 1] >= floor:
                    d_scales[s, 1] = -d_b / sv
                    dz += d_b / z
                d_facing = -(d_a + d_b + d_q) / facing
                a, b = z / (su * facing), z / (sv * facing)
                gux, guy = total[G_UX] * a / fx, total[G_UY] * a / fy
                gvx, gvy = total[G_VX] * b / fx, total[G_VY] * b / fy
                dtvy += gux
                dtvz += guy * X - gux * Y
                dtvx -= guy
                dY -= gux * tvz
                dX += guy * tvz
                dtuz += gvx * Y - gvy * X
                dtuy -= gvx
                dtux += gvy
                dY += gvx * tuz
                dX -= gvy * tuz
                dnx += total[G_QX] / (facing * fx) + d_facing * X
                dny += total[G_QY] / (facing * fy) + d_facing * Y
                dnz += d_facing
                dX += d_facing * nx
                dY += d_facing * ny
            px, py, pz = dX / z, dY / z, dz - (dX * X + dY * Y) / z
            for i in range(3):
                d_means[s, i] = R[0, i] * px + R[1, i] * py + R[2, i] * pz
            sign = _f(-1) if facing > 0 else _f(1)
            n0 = R[0, 0] * dnx + R[1, 0] * dny + R[2, 0] * dnz + sign * total[G_GEO + channels]
            n1 = R[0, 1] * dnx + R[1, 1] * dny + R[2, 1] * dnz + sign * total[G_GEO + channels + 1]
            n2 = R[0, 2] * dnx + R[1, 2] * dny + R[2, 2] * dnz + sign * total[G_GEO + channels + 2]
            u0 = R[0, 0] * dtux + R[1, 0] * dtuy + R[2, 0] * dtuz
            u1 = R[0, 1] * dtux + R[1, 1] * dtuy + R[2, 1] * dtuz
            u2 = R[0, 2] * dtux + R[1, 2] * dtuy + R[2, 2] * dtuz
            v0 = R[0, 0] * dtvx + R[1, 0] * dtvy + R[2, 0] * dtvz
            v1 = R[0, 1] * dtvx + R[1, 1] * dtvy + R[2, 1] * dtvz
            v2 = R[0, 2] * dtvx + R[1, 2] * dtvy + R[2, 2] * dtvz
            w, x, y, zq, inverse = unit_quaternion(q)
            two = _f(2)
            dw = two * (zq * (u1 - v0) + y * (n0 - u2) + x * (v2 - n1))
            dx = two * (y * (u1 + v0) + zq * (u2 + n0) + w * (v2 - n1) - two * x * (v1 + n2))
            dy = two * (x * (u1 + v0) + zq * (v2 + n1) + w * (n0 - u2) - two * y * (u0 + n2))
            dzq = two * (x * (u2 + n0) + y * (v2 + n1) + w * (u1 - v0) - two * zq * (u0 + v1))
            along = dw * w + dx * x + dy * y + dzq * zq
            d_quats[s, 0] = (dw - along * w) * inverse
            d_quats[s, 1] = (dx - along * x) * inverse
            d_quats[s, 2] = (dy - along * y) * inverse
            d_quats[s, 3] = (dzq - along * zq) * inverse
