"""SPZ, Niantic's compressed Gaussians, version 3: columns of 8 to 32 bits, gzipped.

Layout and quantisation are those of https://github.com/nianticlabs/spz (MIT). Version 3 is the last that needs nothing but
gzip, and the first whose rotations have 9 bits a component; every release of the library since reads it.
"""

from __future__ import annotations

import gzip
import struct
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from .cloud import SplatCloud

MAGIC, VERSION, SH_DEGREE = 0x5053474E, 3, 3
POSITION_BITS = 23  # of a signed coordinate, its sign apart
USUAL_FRACTION = 12  # bits after the point, Niantic's own
STEPS = 16  # of a coordinate in a usual sigma, at least: more bits for smaller objects
LOWEST_SCALE, SCALE_STEPS = -10.0, 16.0  # log sigma from -10 to 5.9 in sixteenths
COLOUR_SCALE = 0.15
BUCKET = 4  # of a byte: 6 bits a coefficient; Niantic's usual 4 or 5 leave noise of a few per cent in every colour
RDF_TO_RUB = np.array([1.0, -1.0, -1.0])
"""SPZ is y up and z backward; the same world's PLY counts as y down and z forward. Along each axis."""
GZIP_LEVEL = 9


def write_spz(path: Path, cloud: SplatCloud) -> None:
    """Write a cloud as Niantic's converter writes its PLY: turned from the axes of a PLY to those of SPZ.

    Args:
        path: the file.
        cloud: in a PLY's axes. Sigmas below e^-10 or above e^5.9 world units take these values (`representable`).
    """
    turned = replace(
        cloud.turned(np.diag(RDF_TO_RUB)), quaternions=cloud.quaternions * [1, *RDF_TO_RUB]
    )  # a Gaussian's own axes are turned too, so that they come back as they were
    fraction = _fraction_bits(turned)
    head = struct.pack("<IIIBBBB", MAGIC, VERSION, len(turned), SH_DEGREE, fraction, 0, 0)
    opacity = 1 / (1 + np.exp(-turned.opacity))
    columns: list[NDArray] = [
        _fixed_point(turned.means, fraction),
        _byte(255 * opacity),
        _byte(255 * (COLOUR_SCALE * turned.coefficients[:, 0] + 0.5)),
        _byte(SCALE_STEPS * (turned.log_scales - LOWEST_SCALE)),
        _smallest_three(turned.quaternions),
        _harmonics(turned.coefficients[:, 1:]),
    ]
    content = head + b"".join(column.tobytes() for column in columns)
    path.write_bytes(gzip.compress(content, GZIP_LEVEL, mtime=0))


def representable(cloud: SplatCloud) -> float:
    """How many Gaussians SPZ can hold in their size: not those of captures in millimetres or kilometres.

    Args:
        cloud: any.

    Returns:
        Share of those whose two larger sigmas it has steps for, 0..1.
    """
    large = np.sort(cloud.log_scales, axis=1)[:, 1:]
    fits = (large >= LOWEST_SCALE) & (large <= LOWEST_SCALE + 255 / SCALE_STEPS)
    return float(fits.all(1).mean()) if len(cloud) else 1.0


def _fraction_bits(cloud: SplatCloud) -> int:
    """Bits after the point: as many as the Gaussians' sizes ask for and the largest coordinate leaves room for."""
    if not len(cloud):
        return USUAL_FRACTION
    sigma = float(np.exp(np.median(np.sort(cloud.log_scales, axis=1)[:, 1:])))
    wanted = max(USUAL_FRACTION, int(np.ceil(np.log2(STEPS / sigma))))
    room = POSITION_BITS - np.ceil(np.log2(max(float(np.abs(cloud.means).max()), 1e-9) * (1 + 1e-6)))
    return int(np.clip(min(wanted, room), 0, POSITION_BITS))


def _rounded(values: NDArray) -> NDArray[np.float64]:
    """To the nearest whole number, halves away from zero."""
    return np.trunc(values + np.copysign(0.5, values))


def _byte(values: NDArray) -> NDArray[np.uint8]:
    return np.clip(_rounded(values), 0, 255).astype(np.uint8)


def _fixed_point(values: NDArray, fraction: int) -> NDArray[np.uint8]:
    """24 bits a coordinate, the lowest byte first."""
    most = 2**POSITION_BITS - 1
    whole = np.clip(_rounded(values * 2.0**fraction), -most, most).astype("<i4")
    return whole.view(np.uint8).reshape(*whole.shape, 4)[..., :3]


def _smallest_three(quaternions: NDArray) -> NDArray[np.uint32]:
    """The place of the largest component (of x y z w) in 2 bits, then the others: a sign and 9 bits of |q| sqrt(2)."""
    q = quaternions[:, [1, 2, 3, 0]]
    largest = np.abs(q).argmax(1)
    rows = np.arange(len(q))
    negated = q[rows, largest] < 0
    packed = largest.astype(np.uint32)
    for k in range(4):
        sign = ((q[:, k] < 0) ^ negated).astype(np.uint32)
        size = (511 * np.abs(q[:, k]) * np.sqrt(2) + 0.5).astype(np.uint32)
        packed = np.where(largest == k, packed, (packed << 10) | (sign << 9) | size).astype(np.uint32)
    return packed.astype("<u4")


def _harmonics(coefficients: NDArray) -> NDArray[np.uint8]:
    """Coefficients [N, 15, 3] as bytes about 128, rounded to the middles of buckets."""
    whole = (_rounded(128 * coefficients) + 128).astype(np.int64)
    return np.clip((whole + BUCKET // 2) // BUCKET * BUCKET, 0, 255).astype(np.uint8)
