"""Sensor codes of fewer bits in 16-bit files: 12 bits end at 4095 (moved to the top: 65520), and clipping piles up there."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

T = TypeVar("T")
BITS = (8, 10, 12, 14)
"""Of industrial and photographic sensors' samples."""
COMMONEST_BITS = 12
LOOKED_AT = 32_000_000
"""Samples whose codes are looked at before the question counts as settled."""
LEAST_PILE = 6
"""Samples at the largest code that do not happen by chance in a picture whose codes run on below."""
NEAR = 0.97
"""Clipping leaves fewer samples in the last 3 % below the largest code than on it."""


@dataclass(frozen=True)
class CodeRange:
    """The largest code that these samples can have, of how many bits, and how many samples hold it."""

    white_level: float
    bits: int
    clipped: int


def code_range(images: Sequence[NDArray[np.uint16]]) -> CodeRange | None:
    """What codes [..] of 16-bit files tell: fewer bits with clipped samples at their end; None where nothing says so.

    A picture without clipped samples tells nothing: it may be a dark one of 16 bits.
    """
    total, used = np.zeros(1 << 16, np.int64), bits_used(images)
    for codes in images:
        total += np.bincount(codes.ravel(), minlength=1 << 16)
    lit = np.flatnonzero(total)
    if not len(lit) or lit[-1] == 0:
        return None
    top = int(lit[-1])
    step = used & -used  # codes that are all multiples of 2^k have been moved up by k bits
    for bits in BITS:
        for full in {(1 << bits) - 1, (1 << bits) - step}:
            if top == full and step < 1 << max(0, bits - 7):
                near = int(total[int(NEAR * top) : top].sum())
                if total[top] >= LEAST_PILE and total[top] > near:
                    return CodeRange(float(top), bits - int(step).bit_length() + 1, int(total[top]))
    return None


def bits_used(images: Sequence[NDArray[np.uint16]]) -> int:
    """The bitwise or of all codes."""
    return int(np.bitwise_or.reduce([np.bitwise_or.reduce(codes, axis=None) for codes in images], initial=0))


def low_codes(used: int, path: Path) -> tuple[list[str], list[str]]:
    """(warnings, facts) where 16-bit codes end so low that they may be of a sensor of 10 or 12 bits: dark pictures of 16 bits
    do so as well, and nothing in them decides. It is a warning where they fill the upper half of 12 bits, as well exposed ones
    of the commonest sensors do. used: the bitwise or of all codes; path: the first file."""
    bits = used.bit_length()
    likely = next((b for b in (10, 12) if b - 2 < bits <= b), None)
    if likely is None:
        return [], []
    low = f"no code of these 16-bit files is above {(1 << bits) - 1}"
    say = f"say radiometry.white_level = {(1 << likely) - 1}"
    if bits < COMMONEST_BITS:
        return [], [f"{low}: if they are {likely}-bit codes, {say}"]
    read = "they are read as pictures of 16 bits, darker than a sixteenth"
    return [f"{path}: {low}: {read}; if they are {likely}-bit codes {say} in capture.toml (65535 where they are not)"], []


def moved_up(used: int) -> float | None:
    """The white level of samples moved to the top of 16 bits, whose codes are all multiples of 2^k (k > 0); else None.

    used: the bitwise or of all codes. At least eight bits must be in use, up to the highest.
    """
    step = used & -used
    if used < 1 << 15 or not 1 < step <= 1 << 8:
        return None
    return float((1 << 16) - step)


def some_of(files: Sequence[T], samples_each: int) -> list[T]:
    """As many files (or views), evenly spread, as `LOOKED_AT` samples allow (two at least)."""
    most = max(2, LOOKED_AT // max(1, samples_each))
    if len(files) <= most:
        return list(files)
    return [files[k] for k in np.unique(np.linspace(0, len(files) - 1, most).round().astype(int))]
