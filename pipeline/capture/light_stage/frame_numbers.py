"""Which image of a light stage's pass bears which frame number."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path

from pipeline.capture.naming.files import FLOAT_SUFFIXES, PHOTO_SUFFIXES, RAW_SUFFIXES, UNREADABLE
from pipeline.errors import UserError

KINDS = (FLOAT_SUFFIXES | {".png", ".tif", ".tiff"}, RAW_SUFFIXES, PHOTO_SUFFIXES)
"""Endings of frames, the better first: of frames and previews (or raw files and their JPEG twins) the first kind is read."""
VERSION = re.compile(
    r"[_\-. ](?:ev[+-]?\d+(?:\.\d+)?|exp(?:osure)?[_\-]?\d*\.?\d+s?|t\d*\.\d+s?|v\d+|r\d+|take\d+)$", re.IGNORECASE
)
"""What names end in beside a frame's number: an exposure, a version, a take."""
MOST_NUMBERS = 6
"""Numbers of a name that are tried, from its end."""


def frame_files(folder: Path) -> list[Path]:
    """List the files of a light stage's pass that are frames.

    Args:
        folder: the pass's.

    Returns:
        Files of one kind (linear images before camera raw before photographs), sorted.

    Raises:
        UserError: there is none.
    """
    there = sorted(p for p in folder.iterdir() if p.is_file() and not p.name.startswith("."))
    frames = next((some for kind in KINDS if (some := [p for p in there if p.suffix.lower() in kind])), [])
    if frames:
        return frames
    kinds = Counter(p.suffix.lower() for p in there if p.suffix)
    if not kinds:
        raise UserError(folder, "holds no frame", "add the frames, or remove the camera's folder")
    kind, n = kinds.most_common(1)[0]
    way = UNREADABLE.get(kind, "export the frames as linear EXR or 16-bit TIFF or PNG")
    raise UserError(folder, f"holds no frame that is read, but {n} {kind} files", way)


def numbered(frames: Sequence[Path]) -> dict[int, Path]:
    """Number the frames of a pass: by the last number in each name that tells them apart, exposures and versions left aside.

    Args:
        frames: files of one pass.

    Returns:
        Number to file.

    Raises:
        UserError: a name has no number, or two have the same.
    """
    bare = next((p for p in frames if not re.search(r"\d", p.stem)), None)
    if bare is not None:
        raise UserError(bare, "has no frame number in its name", "name frames by number, as 000002.exr")
    for number in (_last, _before_version, *(_from_end(k) for k in range(2, MOST_NUMBERS + 1))):
        numbers = _numbers(frames, number)
        if numbers is not None and len(set(numbers)) == len(frames):
            return dict(zip(numbers, frames))
    numbers = _numbers(frames, _before_version) or _numbers(frames, _last) or []
    first: dict[int, Path] = {}
    for number_, path in zip(numbers, frames):
        if number_ in first:
            brackets = VERSION.search(path.stem) is not None
            remedy = "merge exposures of one light into one frame" if brackets else "keep one of the two"
            raise UserError(path, f"has the same frame number as {first[number_].name}", remedy)
        first[number_] = path
    raise AssertionError("numbers that are all different were taken above")


def _numbers(frames: Sequence[Path], number: Callable[[str], int | None]) -> list[int] | None:
    """The number of every frame, or None where one has none."""
    found = [number(path.stem) for path in frames]
    return [n for n in found if n is not None] if None not in found else None


def _last(stem: str) -> int | None:
    digits = re.findall(r"\d+", stem)
    return int(digits[-1]) if digits else None


def _before_version(stem: str) -> int | None:
    while (shorter := VERSION.sub("", stem)) != stem:
        stem = shorter
    return _last(stem)


def _from_end(k: int) -> Callable[[str], int | None]:
    """The k-th number from the end of a name."""

    def number(stem: str) -> int | None:
        digits = re.findall(r"\d+", stem)
        return int(digits[-k]) if len(digits) >= k else None

    return number
