"""One picture under two names: a file that was copied once too often stands for a view, or a light, that is missing."""

from __future__ import annotations

import filecmp
import os
from collections import defaultdict
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from pipeline.capture.naming.files import RAW_SUFFIXES, some
from pipeline.capture.pixels.raw import raw_preview
from pipeline.errors import UserError
from pipeline.formats.images import read_stored

if TYPE_CHECKING:
    from pipeline.capture.model import Capture

PIECE = 1 << 12
"""Bytes at three places of a file that are compared first: noise makes them differ."""
MANY = 0.5
"""Share of the pictures that are copies from which it is no slip."""


def copies(paths: Iterable[Path]) -> list[tuple[Path, Path]]:
    """Find files that are the same in every byte.

    Args:
        paths: of files; those that are one by a link are one file that is named twice, and count.

    Returns:
        Pairs, each file with the first that it equals; files that cannot be read equal none.
    """
    alike: dict[tuple[int, bytes], list[Path]] = defaultdict(list)
    for path in dict.fromkeys(paths):
        try:
            size = path.stat().st_size
            with path.open("rb") as stream:
                pieces = []
                for place in (0, size // 2, max(0, size - PIECE)):
                    stream.seek(place)
                    pieces.append(stream.read(PIECE))
        except OSError:
            continue
        alike[size, b"".join(pieces)].append(path)
    found = []
    for group in alike.values():
        firsts: list[Path] = []
        for path in group:
            twin = next((first for first in firsts if _same(first, path)), None)
            if twin is None:
                firsts.append(path)
            else:
                found.append((twin, path))
    return found


def _same(first: Path, second: Path) -> bool:
    try:
        return filecmp.cmp(first, second, shallow=False)
    except OSError:
        return False


def copied_pictures(capture: Capture) -> list[str]:
    """Say which of a capture's pictures are one file under two names: of two views, or of two lights in one pass.

    Args:
        capture: as recognised.

    Returns:
        A warning, or none; pictures of one value all over, as black frames are, may well be the same, and many are where a
        renderer turned something round.
    """
    found: list[tuple[Path, Path]] = []
    for paths in _comparable(capture):
        twins = [pair for pair in copies(paths) if _shows_something(pair[0])]
        found += twins if len(twins) < MANY * len(paths) else []
    if not found:
        return []
    what = "lights" if capture.kind == "light_stage" else "views"
    named = some(" and ".join(os.path.relpath(path, capture.root) for path in pair) for pair in found)
    return [
        f"{capture.root}: {len(found)} of the pictures {'are copies' if len(found) > 1 else 'is a copy'} of another in every "
        f"byte ({named}), which two {what} never are: check which picture is missing"
    ]


def _comparable(capture: Capture) -> Sequence[Sequence[Path]]:
    """Files no two of which should be the same; a file of several views counts once."""
    if capture.light_stage is not None:
        return [passes for c in capture.light_stage.cameras.values() for passes in dict.fromkeys((c.cross, c.parallel))]
    return [[path for view in capture.views for path in view.paths[:1]]]


def _shows_something(path: Path) -> bool:
    try:
        pixels = raw_preview(path) if path.suffix.lower() in RAW_SUFFIXES else read_stored(path)[0]
    except (UserError, ValueError):
        return False
    return bool(pixels.size and np.nanmin(pixels) < np.nanmax(pixels))
