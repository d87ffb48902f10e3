"""How well the lights tell a fitted lobe: standard deviations by its normal equations, and how near a light comes to its peak.

A fit always ends somewhere. Where the samples see only a lobe's flank, or fewer of it than it has parameters, they are matched
by many lobes, and the one that is found is chance: widths and albedo then have variances that say so.
"""

from __future__ import annotations

import math

from pipeline.kernels.compiling import kernel
from pipeline.kernels.numerics import FAST, ONE, ZERO, cholesky_solve
from pipeline.kernels.scratch import matrix, vector
from pipeline.rig.map_flags import GOOD, OUTSIDE, TOO_FEW
from stages.olat.pixel_fit.mixed_tangents import SIZE
from stages.olat.pixel_fit.specular import widths

SURE = 0.15
"""Standard deviation of the log of a width or of the albedo up to which a lobe counts as determined: half of a value (0.4 in
the log) is then 2.7 of them away."""
NEAREST = 1.2
"""Widths between the lobe's peak and the nearest half vector that a light shows: a Gaussian has fallen to 0.24 there, and what
is said of the peak is more extrapolated than seen."""
GRAIN = 1e-3
"""Of the brightest sample: the standard deviation that half floats and the lobe's own form leave at best."""
ONE_WAY = 0.75  # order of a pixel's tangents below which it has no one tangent
UNDETERMINED = 1e6  # standard deviation of what the samples do not determine


@kernel(fastmath=FAST, error_model="numpy")
def strong(light, use, level):
    """Sum and sum of squares of the samples above `level`: noise, which lies below it, is no light."""
    whole = squares = ZERO * level
    for k in range(light.size):
        v, u = light[k], use[k]
        v = v if (u > ZERO) & (v > level) else ZERO
        whole += v
        squares += v * v
    return float(whole), float(squares)


@kernel(fastmath=FAST, error_model="numpy")
def _nearest(hx, hy, hz, use, tx, ty, tz, bx, by, bz, nx, ny, nz, a, b):
    """Least square distance, in widths 1/a along t and 1/b along b, of a light's half vector from the normal (in slopes)."""
    least = ZERO * a + 1e30
    for k in range(hx.size):
        z = nx * hx[k] + ny * hy[k] + nz * hz[k]
        u = a * (tx * hx[k] + ty * hy[k] + tz * hz[k])
        v = b * (bx * hx[k] + by * hy[k] + bz * hz[k])
        r = (u * u + v * v) / (z * z)
        least = min(least, r if (use[k] > ZERO) & (z > ZERO) else least)
    return least


@kernel(error_model="numpy")
def nearest(half, use, frame, large, small):
    """Distance, in widths, of the half vector nearest to the peak of a lobe in `frame` (t along the larger width)."""
    k = half[0].dtype.type
    t, b, n = frame[0], frame[1], frame[2]
    return math.sqrt(_nearest(half[0], half[1], half[2], use, k(t[0]), k(t[1]), k(t[2]), k(b[0]), k(b[1]), k(b[2]),
                              k(n[0]), k(n[1]), k(n[2]), k(1.0 / large), k(1.0 / small)))  # fmt: skip


@kernel(fastmath=FAST, error_model="numpy")
def _noise(g, rho, light, floor, weight):
    square = count = ZERO * rho
    for k in range(g.size):
        r = rho * g[k] - light[k]
        w = weight[k] if floor[k] == ZERO else ZERO
        square += w * r * r
        count += w
    return float(square), float(count)


@kernel(error_model="numpy")
def deviation(equations, n, shape, rho, variance, tied, fixed):
    """Standard deviations: the largest of the log widths and the log albedo, the albedo's, the widths' (root mean square).

    `UNDETERMINED` where the samples leave one free.

    equations [6, 6]: normal equations of n parameters: d1, d2, A, rho of a round lobe (4), d1, d2, A, B, C, rho (6); variance:
    a sample's; tied: what a tie to n_d added to the first two, which is taken out: only samples tell; fixed: n was given.
    """
    scale, system, right, out = vector(6), matrix(6, 6), vector(6), vector(6)
    for k in range(2):
        if fixed:
            for j in range(n):
                equations[j, k] = equations[k, j] = 0.0
            equations[k, k] = 1.0
        else:
            equations[k, k] -= tied
    for k in range(n):
        if not equations[k, k] > 0:
            return UNDETERMINED, UNDETERMINED, UNDETERMINED
        scale[k] = math.sqrt(equations[k, k])
    worst = albedo = width = 0.0
    for which in range(3 if n == 6 else 2):
        for k in range(n):
            right[k] = 0.0
        if which == 0:
            right[n - 1] = 1.0 / rho
        elif n == 4:
            right[2] = 1.0
        else:
            _width_slope(shape, which == 1, right)
        for k in range(n):
            right[k] /= scale[k]
            for j in range(n):
                system[k, j] = equations[k, j] / (scale[k] * scale[j])
        if not cholesky_solve(system, right, n, out):
            return UNDETERMINED, UNDETERMINED, UNDETERMINED
        total = 0.0
        for k in range(n):
            total += right[k] * out[k]
        worst = max(worst, total)
        albedo += total if which == 0 else 0.0
        width += 0.0 if which == 0 else total / (2.0 if n == 6 else 1.0)
    return _root(worst * variance), _root(albedo * variance), _root(width * variance)


@kernel(error_model="numpy")
def _root(variance):
    return min(math.sqrt(variance), UNDETERMINED)


@kernel(error_model="numpy")
def tilt_deviation(equations, n, variance):
    """Root mean square angle (rad) by which noise turns the lobe's normal, ties to n_d included; arguments as `deviation`'s."""
    right, out, total = vector(6), vector(6), 0.0
    system = matrix(6, 6)
    for which in range(2):
        for k in range(n):
            right[k] = 1.0 if k == which else 0.0
            for j in range(n):
                system[k, j] = equations[k, j]
        if not cholesky_solve(system, right, n, out):
            return math.pi
        total += out[which]
    return min(math.sqrt(max(total, 0.0) * variance), math.pi)


@kernel(fastmath=FAST, error_model="numpy")
def _moments(weight, wx, wy, wz):
    a = b = c = d = e = f = ZERO * weight[0]
    for k in range(weight.size):
        p, q, r = weight[k] * wx[k], weight[k] * wy[k], weight[k] * wz[k]
        a += p * wx[k]
        b += p * wy[k]
        c += p * wz[k]
        d += q * wy[k]
        e += q * wz[k]
        f += r * wz[k]
    return float(a), float(b), float(c), float(d), float(e), float(f)


@kernel(error_model="numpy")
def direction_deviation(weight, w, n, noise, size):
    """Root mean square angle (rad) by which noise (a sample's standard deviation) turns a diffuse normal n of this albedo.

    The covariance of the scaled normal is noise² (sum of w l lᵀ)⁻¹ over the lights in use; what of it lies across n turns it.
    """
    a, b, c, d, e, f = _moments(weight, w[0], w[1], w[2])
    xx, yy, zz = d * f - e * e, a * f - c * c, a * d - b * b
    xy, xz, yz = c * e - b * f, b * e - c * d, b * c - a * e
    determinant = a * xx + b * xy + c * xz
    if not determinant > 0:
        return math.pi
    along = (n[0] * n[0] * xx + n[1] * n[1] * yy + n[2] * n[2] * zz
             + 2.0 * (n[0] * n[1] * xy + n[0] * n[2] * xz + n[1] * n[2] * yz))  # fmt: skip
    across = max(xx + yy + zz - along, 0.0) / determinant
    return min(noise / size * math.sqrt(across), math.pi)


@kernel(fastmath=FAST, error_model="numpy")
def albedo_deviation(rgb, weight, wx, wy, wz, nx, ny, nz, red, green, blue):
    """Standard deviation of an albedo's channels, the noise being the weighted misfit of all three."""
    square = count = power = ZERO * nx
    for k in range(weight.size):
        p = nx * wx[k] + ny * wy[k] + nz * wz[k]
        r, g, b = rgb[0, k] - red * p, rgb[1, k] - green * p, rgb[2, k] - blue * p
        square += weight[k] * (r * r + g * g + b * b)
        count += weight[k]
        power += weight[k] * p * p
    return math.sqrt(square / (count * power) / (ONE + ONE + ONE)) if power > ZERO else ZERO


@kernel(error_model="numpy")
def _width_slope(shape, wide, out):
    """Derivatives of the logarithm of the larger (`wide`) or the smaller width by A, B, C, into out[2:5].

    The widths are 1 / sqrt of the eigenvalues of [[a², a c], [a c, c² + b²]].
    """
    a, b, c = math.exp(shape[0]), math.exp(shape[1]), shape[2]
    xx, xy, yy = a * a, a * c, c * c + b * b
    mean, half = 0.5 * (xx + yy), 0.5 * (xx - yy)
    root = math.sqrt(half * half + xy * xy)
    large = mean + root
    value = (a * b) ** 2 / large if wide else large
    angle = 0.5 * math.atan2(2 * xy, xx - yy) + (0.5 * math.pi if wide else 0.0)
    x, y = math.cos(angle), math.sin(angle)
    out[2] = -(x * x * a * a + x * y * a * c) / value
    out[3] = -y * y * b * b / value
    out[4] = -(x * y * a + y * y * c) / value


@kernel(error_model="numpy")
def determined(frame, shape, rho, order, ended, equations, form, half, light, floor, use, weight, g, top, fixed):
    """GOOD where the lights tell the lobe that was fitted to them; OUTSIDE where its peak lies beyond them; else TOO_FEW.

    ended: `lobe_fit.fit_lobe`'s; form: deviation of the log albedo by what other forms of lobe fit as well
    (`form_evidence.doubt`); fixed: the normal was given. A fit counts as ended where a Newton step would lower its cost by less
    than one deviation of one parameter does. With the flag come the standard deviations of the log albedo and the log widths,
    and the angle (rad) by which noise turns the normal.
    """
    large, small, angle = widths(shape)
    axes = matrix(3, 3)
    along, across = math.cos(angle), math.sin(angle)
    for k in range(3):
        axes[0, k] = along * frame[0, k] + across * frame[1, k]
        axes[1, k] = along * frame[1, k] - across * frame[0, k]
        axes[2, k] = frame[2, k]
    peak = nearest(half, use, axes, large, small if order > ONE_WAY else large)
    if peak > NEAREST:
        return OUTSIDE, 1.0, 1.0, math.pi
    held, left, worst, albedo, width, tilt = ended
    mixed = worst > 0.0
    n = SIZE if mixed else (4 if shape[0] == shape[1] and shape[2] == 0.0 else 6)
    square, count = _noise(g, light.dtype.type(rho), light, floor, weight)
    variance = max(square / max(count - n, 1.0), (GRAIN * top) ** 2)
    if mixed:
        unsure, albedo, width = _root(worst * variance), _root(albedo * variance), _root(width * variance)
        tilt = min(math.sqrt(tilt * variance), math.pi)
    else:
        tilt = 0.0 if fixed else tilt_deviation(equations, n, variance)
        unsure, albedo, width = deviation(equations, n, shape, rho, variance, held, fixed)
    albedo = math.sqrt(albedo * albedo + form * form)
    if max(unsure, albedo) < SURE and left <= variance:
        return GOOD, albedo, width, tilt
    return (OUTSIDE if peak > 0.5 * NEAREST else TOO_FEW), albedo, width, tilt
