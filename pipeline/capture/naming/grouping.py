"""Which files make one view: polariser angles and exposures by file name."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pipeline.capture.config import CaptureConfig
from pipeline.formats.image_parts import Page

ANGLE = re.compile(
    r"^(?P<view>.+?)[_\-. ]?(?:pol|lp|angle|ang|deg|a|p)?[_\-]?(?P<angle>\d{1,3}(?:[.]\d+)?)(?:deg|°)?$", re.IGNORECASE
)
ANGLE_ALONE = re.compile(r"^(?:pol|lp|angle|ang|a|p|i)?[_\-]?(?P<angle>\d{1,3}(?:[.]\d+)?)(?:deg|°)?$", re.IGNORECASE)
EXPOSURE = re.compile(
    r"^(?P<view>.+?)[_\- ](?:ev(?P<ev>[+-]?\d+(?:\.\d+)?)|exp(?:osure)?[_\-]?(?P<seconds>\d*\.?\d+)s?|t(?P<t>\d*\.\d+)s?)$",
    re.IGNORECASE,
)
USUAL = (frozenset({0, 45, 90, 135}), frozenset({0, 60, 120}), frozenset({0, 30, 60, 90, 120, 150}), frozenset({0, 45, 90}))
MIN_STEP_DEG = 5.0
"""Angles nearer than this are frame numbers: nobody turns a filter by a degree."""


@dataclass(frozen=True)
class Exposure:
    """One file of a bracket: seconds if the name says so, else stops relative to the others (None: EXIF decides);
    `page`: which image of a file that holds several."""

    path: Path
    seconds: float | None = None
    stops: float | None = None
    page: Page | None = None


@dataclass(frozen=True)
class Group:
    """The files of one view: exposures by polariser angle (degrees; None where there is no stack)."""

    view: str
    angles: Mapping[float | None, tuple[Exposure, ...]]

    @property
    def paths(self) -> tuple[Path, ...]:
        return tuple(dict.fromkeys(e.path for exposures in self.angles.values() for e in exposures))

    @property
    def is_stack(self) -> bool:
        return None not in self.angles


def group_files(paths: list[Path], folder: Path, config: CaptureConfig, stacks: bool = True) -> list[Group]:
    """Views of the image files below `folder`, sorted by VIEW: angle stacks and exposure brackets put together."""
    stems = {path: path.relative_to(folder).with_suffix("").as_posix() for path in paths}
    exposures: dict[str, list[Exposure]] = defaultdict(list)
    brackets = _brackets(stems)
    for path, stem in stems.items():
        base, seconds, stops = brackets.get(path, (stem, None, None))
        exposures[base].append(Exposure(path, seconds, stops))
    split = _angles(list(exposures), config) if stacks else None
    if split is None:
        return [
            Group(b.replace("/", "_"), {None: tuple(e)})
            for b, e in sorted(exposures.items(), key=lambda i: i[0].replace("/", "_"))
        ]
    views: dict[str, dict[float | None, tuple[Exposure, ...]]] = defaultdict(dict)
    for base, found in exposures.items():
        view, angle = split[base]
        views[view.replace("/", "_")][angle] = tuple(found)
    return [Group(view, dict(sorted(angles.items(), key=lambda i: i[0] or 0))) for view, angles in sorted(views.items())]


def _brackets(stems: Mapping[Path, str]) -> dict[Path, tuple[str, float | None, float | None]]:
    """Files named as exposures, if at least two share a base."""
    found: dict[str, list[tuple[Path, float | None, float | None]]] = defaultdict(list)
    for path, stem in stems.items():
        match = EXPOSURE.match(stem)
        if match:
            seconds = match["seconds"] or match["t"]
            found[match["view"]].append(
                (path, float(seconds) if seconds else None, float(match["ev"]) if match["ev"] else None)
            )
    return {path: (base, s, e) for base, members in found.items() if len(members) > 1 for path, s, e in members}


def _angles(bases: list[str], config: CaptureConfig) -> dict[str, tuple[str, float]] | None:
    """VIEW and angle of every base name, or None where the names are no stack."""
    told = config.stack.angles_deg
    if told:
        out = {}
        for base in bases:
            for suffix in sorted(told, key=len, reverse=True):
                if base.endswith(suffix):
                    out[base] = (base[: -len(suffix)].rstrip("_-/ ") or "view", told[suffix])
                    break
            else:
                return None
        return {b: (v, turned(a, config)) for b, (v, a) in out.items()}
    for parse in (_by_suffix, _by_folder, _by_last_folder):
        split = {base: parse(base) for base in bases}
        if any(s is None for s in split.values()):
            continue
        sure = {b: s for b, s in split.items() if s is not None}
        if _plausible(sure):
            return {b: (v, turned(a, config)) for b, (v, a) in sure.items()}
    return None


def _by_suffix(base: str) -> tuple[str, float] | None:
    folder, _, name = base.rpartition("/")
    match = ANGLE.match(name)
    if not match or not match["view"]:
        return None
    return (f"{folder}/{match['view']}" if folder else match["view"]).rstrip("_-. "), float(match["angle"])


def _by_folder(base: str) -> tuple[str, float] | None:
    first, _, rest = base.partition("/")
    match = ANGLE_ALONE.match(first)
    return (rest, float(match["angle"])) if match and rest else None


def _by_last_folder(base: str) -> tuple[str, float] | None:
    folder, _, name = base.rpartition("/")
    match = ANGLE_ALONE.match(name)
    return (folder, float(match["angle"])) if match and folder else None


def _plausible(split: Mapping[str, tuple[str, float]]) -> bool:
    """Whether these are polariser angles and not frame numbers or turntable positions: every view has the same
    three or more angles below 180°, apart by more than a frame count; one view alone only with the usual angles."""
    by_view: dict[str, list[float]] = defaultdict(list)
    for view, angle in split.values():
        by_view[view].append(angle)
    sets = {frozenset(angles) for angles in by_view.values()}
    most = max(sets, key=lambda s: sum(frozenset(a) == s for a in by_view.values()))
    if any(len(set(a)) != len(a) for a in by_view.values()) or len(most) < 3 or max(most) > 180:
        return False
    alike = sum(s <= most for s in map(frozenset, by_view.values()))
    if alike < 0.9 * len(by_view):
        return False
    steps = np.diff(sorted(most))
    return bool(steps.min() >= MIN_STEP_DEG) and (len(by_view) > 1 or most in USUAL)


def turned(angle: float, config: CaptureConfig) -> float:
    """The file's angle as ours: counter-clockwise from the image's x axis."""
    return (-angle if config.stack.clockwise else angle) + config.stack.zero_deg
