"""Numba kernels over single splats: activation and its adjoint, rows in and out, Adam. Their twins in torch are beside the
callers: gaussians.py, taken_rows.py, optimiser.py, densify.py, albedo_light_scale.py."""

from __future__ import annotations

import numpy as np

from pipeline.kernels.compiling import kernel
from pipeline.kernels.numerics import exp

MATH = {"contract", "reassoc", "nsz", "arcp"}
_ONE, _ZERO = np.float32(1), np.float32(0)
_LEAST_LENGTH = np.float32(1e-12)  # of a normal, as in `gaussians.unit`
_TINY = np.float32(1e-30)


@kernel(nogil=True, error_model="numpy", fastmath=MATH)
def sigmoids(x, shift, low, span, out):
    """out [M] = low + span * sigmoid(x + shift)."""
    for i in range(len(x)):
        t = x[i] + shift
        small = exp(-abs(t))
        out[i] = low + span * ((_ONE if t >= _ZERO else small) / (_ONE + small))


@kernel(nogil=True, error_model="numpy", fastmath=MATH)
def sigmoid_slopes(value, low, span, gradient, out):
    """Adjoint of `sigmoids` from its values: out [M]."""
    inverse = _ONE / span
    for i in range(len(value)):
        s = (value[i] - low) * inverse
        out[i] = gradient[i] * span * s * (_ONE - s)


@kernel(nogil=True, error_model="numpy", fastmath=MATH)
def orient(raw, log_scale, normal, quaternion, scale):
    """Unit normals [N, 3], their quaternions [N, 4] (`gaussians.normal_quaternions`) and scales [N, 2] of raw normals and log
    scales [N]."""
    for i in range(len(raw)):
        x, y, z = raw[i, 0], raw[i, 1], raw[i, 2]
        inverse = _ONE / max(np.sqrt(x * x + y * y + z * z), _LEAST_LENGTH)
        x, y, z = x * inverse, y * inverse, z * inverse
        normal[i, 0], normal[i, 1], normal[i, 2] = x, y, z
        if z >= _ZERO:
            quaternion[i, 0], quaternion[i, 1], quaternion[i, 2], quaternion[i, 3] = _ONE + z, -y, x, _ZERO
        else:
            quaternion[i, 0], quaternion[i, 1], quaternion[i, 2], quaternion[i, 3] = -y, _ONE - z, _ZERO, x
        size = np.exp(log_scale[i])
        scale[i, 0], scale[i, 1] = size, size


@kernel(nogil=True, error_model="numpy", fastmath=MATH)
def orient_slopes(raw, normal, scale, g_normal, g_scale, g_raw, g_log_scale):
    """Adjoint of `orient`, whose quaternions carry no gradient."""
    for i in range(len(raw)):
        x, y, z = raw[i, 0], raw[i, 1], raw[i, 2]
        length = np.sqrt(x * x + y * y + z * z)
        inverse = _ONE / max(length, _LEAST_LENGTH)
        along = _ZERO
        if length > _LEAST_LENGTH:
            along = normal[i, 0] * g_normal[i, 0] + normal[i, 1] * g_normal[i, 1] + normal[i, 2] * g_normal[i, 2]
        for c in range(3):
            g_raw[i, c] = (g_normal[i, c] - along * normal[i, c]) * inverse
        g_log_scale[i] = scale[i, 0] * (g_scale[i, 0] + g_scale[i, 1])


@kernel(nogil=True, error_model="numpy", fastmath=MATH)
def take_rows(rows, means, quaternions, scales, opacities, normals, albedo, roughness, ior, extra, out, features):
    """Rows of the splats: `out` (means [R, 3], quaternions [R, 4], scales [R, 2], opacities [R]); features [R, 8 + C] are
    normal, albedo, roughness, IoR and extra [N, C]."""
    mean, quaternion, scale, opacity = out
    for r in range(len(rows)):
        i = rows[r]
        for c in range(3):
            mean[r, c] = means[i, c]
            features[r, c] = normals[i, c]
            features[r, 3 + c] = albedo[i, c]
        for c in range(4):
            quaternion[r, c] = quaternions[i, c]
        scale[r, 0], scale[r, 1], opacity[r] = scales[i, 0], scales[i, 1], opacities[i]
        features[r, 6], features[r, 7] = roughness[i], ior[i]
        for c in range(extra.shape[1]):
            features[r, 8 + c] = extra[i, c]


@kernel(nogil=True, error_model="numpy", fastmath=MATH)
def put_rows(rows, gradients, g_features, means, scales, opacities, normals, albedo, roughness, ior, extra):
    """Adjoint of `take_rows`; the outputs are zeroed. gradients: of means, scales and opacities [R, ...]."""
    mean, scale, opacity = gradients
    for r in range(len(rows)):
        i = rows[r]
        for c in range(3):
            means[i, c] = mean[r, c]
            normals[i, c] = g_features[r, c]
            albedo[i, c] = g_features[r, 3 + c]
        scales[i, 0], scales[i, 1], opacities[i] = scale[r, 0], scale[r, 1], opacity[r]
        roughness[i], ior[i] = g_features[r, 6], g_features[r, 7]
        for c in range(extra.shape[1]):
            extra[i, c] = g_features[r, 8 + c]


@kernel(nogil=True, error_model="numpy", fastmath=MATH)
def cosines(means, normals, centre, out):
    """Cosine out [N] between each splat's normal and the direction to `centre` [3]."""
    for i in range(len(means)):
        x, y, z = centre[0] - means[i, 0], centre[1] - means[i, 1], centre[2] - means[i, 2]
        dot = normals[i, 0] * x + normals[i, 1] * y + normals[i, 2] * z
        out[i] = dot / np.sqrt(max(x * x + y * y + z * z, _TINY))


@kernel(nogil=True, error_model="numpy", fastmath=MATH)
def adam_rows(gradient, first, second, beta1, beta2, bias1, bias2, epsilon, together, out):
    """`optimiser.adam_update` of [N, C]; what is not finite in the gradient counts as 0.

    bias1, bias2: 1 - beta^steps. together: the channels of a row share one step length.
    """
    count, channels = gradient.shape
    for i in range(count):
        mean = _ZERO
        for c in range(channels):
            g = gradient[i, c]
            if not np.isfinite(g):
                g = _ZERO
            first[i, c] += (_ONE - beta1) * (g - first[i, c])
            second[i, c] = beta2 * second[i, c] + (_ONE - beta2) * g * g
            mean += second[i, c]
        mean /= np.float32(channels) * bias2
        for c in range(channels):
            size = mean if together else second[i, c] / bias2
            out[i, c] = first[i, c] / (bias1 * (np.sqrt(size) + epsilon))


@kernel(nogil=True, error_model="numpy", fastmath=MATH)
def count_view(rows, gradient, weight, gradients, drawn):
    """`densify.Activity.add`: what a view did to the splats `rows` [R] into the sums [N]."""
    for r in range(len(rows)):
        i = rows[r]
        gradients[i] += gradient[r]
        drawn[i] += _ONE if weight[r] > _ZERO else _ZERO


@kernel(nogil=True, error_model="numpy", fastmath=MATH)
def scale_gradient(albedo, gradient, most, share, out):
    """Sum out [3] of gradient [N, 3] times share = 1 / (1 - sigmoid(albedo)), the sigmoid at most `most`."""
    for c in range(3):
        out[c] = 0.0
    for i in range(len(albedo)):
        for c in range(3):
            share[i, c] = _ONE / (_ONE - min(_ONE / (_ONE + np.exp(-albedo[i, c])), most))
            out[c] += share[i, c] * gradient[i, c]
