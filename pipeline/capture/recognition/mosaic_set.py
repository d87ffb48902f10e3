"""Which of a capture's files are polariser mosaics: by channels, by what capture.toml says, and by a look at a few."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from pipeline.capture.config import CaptureConfig, MosaicConfig
from pipeline.capture.mosaic.sensor_files import CARRIER_SHARE, carriers_seen, single_plane
from pipeline.capture.naming.files import FLOAT_SUFFIXES, RAW_SUFFIXES, some
from pipeline.errors import UserError
from pipeline.formats.image_parts import without_alpha
from pipeline.formats.images import channel_names, image_size

CLEARLY_NONE = CARRIER_SHARE / 4
"""Twice what textured photographs and grey pictures show at most; mosaics show 0.12 and more."""
MOST_KINDS = 12
"""Kinds of names that are looked at beside the main one."""
STRAYS = "no polariser mosaics, as the others are"


@dataclass(frozen=True)
class MosaicSet:
    """The files that hold mosaics, and those beside them that do not."""

    mosaics: tuple[Path, ...]
    others: tuple[Path, ...]


def mosaic_set(paths: Sequence[Path], config: CaptureConfig) -> MosaicSet | None:
    """Mosaics and others among the files `paths` (one a view); None where they are not mosaics.

    A `[mosaic]` table says so of any kind of file. Raises UserError where it misses some, or where the set is mixed.
    """
    specified = config.mosaic != MosaicConfig()
    if not paths:
        return None
    kinds: dict[tuple[str, int], list[Path]] = defaultdict(list)
    for path in paths:
        kinds[_kind(path)].append(path)
    found = {kind: files for kind, files in kinds.items() if _may_hold(kind, files, specified)}
    if specified:
        if len(found) < len(kinds):
            missed = sorted(p for kind, files in kinds.items() if kind not in found for p in files)
            names = f"{len(missed)} of {len(paths)} images ({some(p.name for p in missed)})"
            fault = f"[mosaic] is set, but {names} have channels that differ: they hold no mosaic"
            raise UserError(config.path or "capture.toml", fault, "give the sensor's single-channel files, or drop the table")
        return MosaicSet(tuple(paths), ())
    mosaics = [p for files in found.values() if carriers_seen(files, config) > CARRIER_SHARE for p in _carrying(files, config)]
    others = sorted(set(paths) - set(mosaics))
    if len(mosaics) * 4 < len(paths):
        return None
    if len(mosaics) < len(others):
        fault = f"{len(mosaics)} images are polariser mosaics, {len(others)} are not ({some(p.name for p in others)})"
        raise UserError(others[0].parent, fault, "move one kind away, or set layout in capture.toml")
    return MosaicSet(tuple(p for p in paths if p in set(mosaics)), tuple(others))


def _kind(path: Path) -> tuple[str, int]:
    suffix = path.suffix.lower()
    if suffix in RAW_SUFFIXES:
        return "raw", 1
    colours = len(without_alpha(channel_names(path, plain=True)))
    return "float" if suffix in FLOAT_SUFFIXES else "codes", colours


def _may_hold(kind: tuple[str, int], files: list[Path], specified: bool) -> bool:
    """Whether files of this kind can be mosaics: sensor codes of one channel, or of equal ones; any file if [mosaic] is set."""
    family, channels = kind
    if family != "codes" and not specified:
        return False
    return channels == 1 or all(single_plane(p) for p in (files[0], files[len(files) // 2], files[-1]))


def _carrying(files: list[Path], config: CaptureConfig) -> list[Path]:
    """The files less those named or sized unlike the most, in which no pattern is seen."""
    alike: dict[tuple[str, tuple[int, int]], list[Path]] = defaultdict(list)
    for path in files:
        alike[re.sub(r"\d+", "#", path.stem), image_size(path)].append(path)
    main = max(alike.values(), key=len)
    odd = [group for group in alike.values() if group is not main][:MOST_KINDS]
    bare = {p for group in odd if carriers_seen(group, config) < CLEARLY_NONE for p in group}
    return [p for p in files if p not in bare]
