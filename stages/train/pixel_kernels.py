"""Numba kernels over a view's pixels: attributes divided by opacity, losses of radiance and coverage. Twins in torch beside
their callers: `pixel_attributes.py`, `views/losses.py`."""

from __future__ import annotations

import numpy as np

from pipeline.kernels.compiling import kernel

MATH = {"contract", "reassoc", "nsz", "arcp"}
_ONE, _ZERO = np.float32(1), np.float32(0)
_LEAST_LENGTH = np.float32(1e-12)  # of a normal, as in `gaussians.unit`


@kernel(nogil=True, error_model="numpy", fastmath=MATH)
def divide(features, alpha, index, least, length, out):
    """Attributes `out` (normal, albedo, roughness, ior, more, alpha) of the pixels `index`, and their normals' lengths [P]."""
    normal, albedo, roughness, ior, more, opacity = out
    for p in range(len(index)):
        i = index[p]
        opacity[p] = alpha[i]
        share = _ONE / max(alpha[i], least)
        x, y, z = features[i, 0] * share, features[i, 1] * share, features[i, 2] * share
        length[p] = np.sqrt(x * x + y * y + z * z)
        inverse = _ONE / max(length[p], _LEAST_LENGTH)
        normal[p, 0], normal[p, 1], normal[p, 2] = x * inverse, y * inverse, z * inverse
        for c in range(3):
            albedo[p, c] = features[i, 3 + c] * share
        roughness[p], ior[p] = features[i, 6] * share, features[i, 7] * share
        for c in range(more.shape[1]):
            more[p, c] = features[i, 8 + c] * share


@kernel(nogil=True, error_model="numpy", fastmath=MATH)
def divide_slopes(index, least, length, values, gradients, features, alpha):
    """Adjoint of `divide`: `values` are its outputs; features [H W, 8 + C] and alpha [H W] are zeroed."""
    normal, albedo, roughness, ior, more, opacity = values
    g_normal, g_albedo, g_roughness, g_ior, g_more, g_alpha = gradients
    for p in range(len(index)):
        i = index[p]
        share = _ONE / max(opacity[p], least)
        along = _ZERO
        if length[p] > _LEAST_LENGTH:
            along = normal[p, 0] * g_normal[p, 0] + normal[p, 1] * g_normal[p, 1] + normal[p, 2] * g_normal[p, 2]
        inverse = _ONE / max(length[p], _LEAST_LENGTH)
        total = g_roughness[p] * roughness[p] + g_ior[p] * ior[p]
        for c in range(3):  # a unit normal does not change with alpha
            features[i, c] = (g_normal[p, c] - along * normal[p, c]) * inverse * share
            features[i, 3 + c] = g_albedo[p, c] * share
            total += g_albedo[p, c] * albedo[p, c]
        features[i, 6], features[i, 7] = g_roughness[p] * share, g_ior[p] * share
        for c in range(more.shape[1]):
            features[i, 8 + c] = g_more[p, c] * share
            total += g_more[p, c] * more[p, c]
        alpha[i] = g_alpha[p] - (total * share if opacity[p] >= least else _ZERO)


@kernel(nogil=True, error_model="numpy", fastmath=MATH)
def _encoded(x, toe, gamma, origin, steepness):
    """Encoding of radiance (`losses.encode`) and its slope."""
    up = max(x, _ZERO)
    power = (up + toe) ** gamma
    slope = gamma * power / (up + toe)
    if x < _ZERO:
        return power - origin + steepness * x, steepness
    return power - origin, slope


@kernel(nogil=True, error_model="numpy", fastmath=MATH)
def radiance_terms(predicted, target, weight, toe, gamma, width, gradient):
    """Weighted sum of `losses.radiance_loss` [P, 3], and its gradient."""
    origin = toe**gamma
    steepness = gamma * origin / toe
    sum_, third, width2 = 0.0, _ONE / np.float32(3), width * width
    for p in range(len(predicted)):
        row = _ZERO
        for c in range(3):
            value, slope = _encoded(predicted[p, c], toe, gamma, origin, steepness)
            wanted, _ = _encoded(target[p, c], toe, gamma, origin, steepness)
            r = value - wanted
            root = np.sqrt(r * r + width2)
            row += root - width
            gradient[p, c] = weight[p] * third * r / root * slope
        sum_ += weight[p] * third * row
    return sum_


@kernel(nogil=True, error_model="numpy", fastmath=MATH)
def stokes_terms(predicted, target, weight, toe, gamma, width, gradient):
    """Weighted sum of `losses.stokes_loss` of [P, 3, 3], and its gradient, which is zero in s0."""
    sum_, sixth, width2 = 0.0, _ONE / np.float32(6), width * width
    for p in range(len(predicted)):
        row = _ZERO
        for c in range(3):
            gradient[p, 0, c] = _ZERO
            slope = gamma * (max(target[p, 0, c], _ZERO) + toe) ** (gamma - _ONE)
            for s in range(1, 3):
                r = slope * (predicted[p, s, c] - target[p, s, c])
                root = np.sqrt(r * r + width2)
                row += root - width
                gradient[p, s, c] = weight[p] * sixth * r / root * slope
        sum_ += weight[p] * sixth * row
    return sum_


@kernel(nogil=True, error_model="numpy", fastmath=MATH)
def coverage_terms(alpha, target, weight, gradient):
    """Weighted sum of |alpha - target| over [M], its gradient, and the sum of the target."""
    sum_, area = 0.0, 0.0
    for i in range(len(alpha)):
        difference = alpha[i] - target[i]
        sum_ += abs(difference) * weight[i]
        area += target[i]
        gradient[i] = weight[i] if difference > _ZERO else (-weight[i] if difference < _ZERO else _ZERO)
    return sum_, area
