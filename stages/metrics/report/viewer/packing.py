"""Arrays as text in a page: little-endian bytes, deflated, in base64; and the few-byte forms of directions and radiance."""

from __future__ import annotations

import base64
import zlib
from typing import Any

import numpy as np
from numpy.typing import NDArray

KINDS = {"int8", "uint8", "uint16", "uint32", "int16", "float32"}
"""Element types that the page's scripts read."""
RGBE_BIAS = 136  # Ward's "Real Pixels" (Graphics Gems II, 1991): the exponent's excess of 128, and 8 bits of mantissa


def packed(values: NDArray) -> dict[str, Any]:
    """An array as {"kind", "shape", "data"}, which `unpack` of bytes.js reads; `kind` is one of KINDS."""
    if values.dtype.name not in KINDS:
        raise ValueError(f"{values.dtype.name}: the viewer reads {', '.join(sorted(KINDS))}")
    stored = np.ascontiguousarray(values, values.dtype.newbyteorder("<"))
    text = base64.b64encode(zlib.compress(stored.tobytes(), 9)).decode()
    return {"kind": values.dtype.name, "shape": list(values.shape), "data": text}


def unpacked(entry: dict[str, Any]) -> NDArray:
    """The array that `packed` took."""
    raw = zlib.decompress(base64.b64decode(entry["data"]))
    return np.frombuffer(raw, np.dtype(entry["kind"]).newbyteorder("<")).reshape(entry["shape"])


def octahedral(directions: NDArray) -> NDArray[np.int16]:
    """Unit vectors [..., 3] as int16 [..., 2] on the unfolded octahedron (Cigolle et al. 2014), y its axis; 0 as 0, 0 (up)."""
    d = np.asarray(directions, float)
    d = d / np.maximum(np.abs(d).sum(-1, keepdims=True), 1e-30)
    x, y, z = d[..., 0], d[..., 1], d[..., 2]
    sign_x, sign_z = np.where(x < 0, -1.0, 1.0), np.where(z < 0, -1.0, 1.0)
    folded = np.where(y < 0, (1 - np.abs(z)) * sign_x, x), np.where(y < 0, (1 - np.abs(x)) * sign_z, z)
    return np.rint(np.stack(folded, -1) * 32767).astype(np.int16)


def unfolded(pair: NDArray[np.int16]) -> NDArray[np.float64]:
    """Unit vectors [..., 3] of `octahedral`."""
    x, z = np.moveaxis(np.asarray(pair, float) / 32767, -1, 0)
    y = 1 - np.abs(x) - np.abs(z)
    sign_x, sign_z = np.where(x < 0, -1.0, 1.0), np.where(z < 0, -1.0, 1.0)
    lower = np.where(y < 0, (1 - np.abs(z)) * sign_x, x), np.where(y < 0, (1 - np.abs(x)) * sign_z, z)
    d = np.stack([lower[0], y, lower[1]], -1)
    return np.asarray(d / np.linalg.norm(d, axis=-1, keepdims=True), np.float64)


def rgbe(radiance: NDArray) -> NDArray[np.uint8]:
    """Radiance [..., 3] >= 0 as three mantissas and a shared exponent [..., 4]: within 1 % of the largest channel."""
    largest = np.maximum(np.asarray(radiance, float).max(-1), 0)
    exponent = np.where(largest > 1e-32, np.floor(np.log2(np.maximum(largest, 1e-32))) + 1, 0)
    scale = np.where(largest > 1e-32, np.exp2(8 - exponent), 0)
    out = np.empty((*largest.shape, 4), np.uint8)
    out[..., :3] = np.clip(np.floor(radiance * scale[..., None]), 0, 255)
    out[..., 3] = np.where(largest > 1e-32, exponent + RGBE_BIAS - 8, 0)
    return out


def radiance_of(pixels: NDArray[np.uint8]) -> NDArray[np.float64]:
    """Radiance [..., 3] of `rgbe`: the middle of each mantissa's step."""
    scale = np.where(pixels[..., 3] > 0, np.exp2(pixels[..., 3].astype(float) - RGBE_BIAS), 0)
    return np.asarray((pixels[..., :3] + 0.5) * scale[..., None], np.float64)
