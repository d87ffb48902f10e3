"""Which files make one view: polariser angles and exposures by file name."""

from __future__ import annotations

import re
from collections import Counter, defaultdict
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pipeline.capture.config import CaptureConfig
from pipeline.capture.naming.files import some
from pipeline.errors import UserError
from pipeline.formats.image_parts import Page

_NUMBER, _WORDS = r"[_\-]?(?P<angle>\d{1,3}(?:[.]\d+)?)(?:deg|°)?$", "polari[sz]er|polar|pol|lp|angle|ang|deg|a|p"
ANGLE = re.compile(rf"^(?P<view>.+?)[_\-. ]?(?:{_WORDS})?{_NUMBER}", re.IGNORECASE)
ANGLE_ALONE = re.compile(rf"^(?:{_WORDS}|i)?{_NUMBER}", re.IGNORECASE)
EXPOSURE = re.compile(
    r"^(?P<view>.+?)[_\- ](?:ev(?P<ev>[+-]?\d+(?:\.\d+)?)|exp(?:osure)?[_\-]?(?P<seconds>\d*\.?\d+)s?|t(?P<t>\d*\.\d+)s?)$",
    re.IGNORECASE,
)
USUAL = (frozenset({0, 45, 90, 135}), frozenset({0, 60, 120}), frozenset({0, 30, 60, 90, 120, 150}), frozenset({0, 45, 90}))
MIN_STEP_DEG = 5.0
"""Angles nearer than this are frame numbers: nobody turns a filter by a degree."""


@dataclass(frozen=True)
class Exposure:
    """One file of an exposure bracket.

    Fields:
        path: the file.
        seconds: where the name says so.
        stops: relative to the others, where the name says so; None for both: EXIF decides.
        page: which image of a file that holds several.
    """

    path: Path
    seconds: float | None = None
    stops: float | None = None
    page: Page | None = None


@dataclass(frozen=True)
class Group:
    """The files of one view.

    Fields:
        view: VIEW.
        angles: exposures by polariser angle, degrees; the angle is None where there is no stack.
    """

    view: str
    angles: Mapping[float | None, tuple[Exposure, ...]]

    @property
    def paths(self) -> tuple[Path, ...]:
        return tuple(dict.fromkeys(e.path for exposures in self.angles.values() for e in exposures))

    @property
    def is_stack(self) -> bool:
        return None not in self.angles


def group_files(paths: list[Path], folder: Path, config: CaptureConfig, stacks: bool = True) -> list[Group]:
    """Views of the image files below `folder`, sorted by VIEW: angle stacks and exposure brackets put together.

    Files that fit no stack where most others do are in no group. Raises UserError, see `group_and_rest`.
    """
    return group_and_rest(paths, folder, config, stacks)[0]


def group_and_rest(
    paths: list[Path], folder: Path, config: CaptureConfig, stacks: bool = True
) -> tuple[list[Group], list[Path]]:
    """The views as `group_files` has them, and the files that fit no stack.

    Raises UserError where capture.toml's angles miss a file or name none, or where about as many files fit as do not.
    """
    stems = {path: path.relative_to(folder).with_suffix("").as_posix() for path in paths}
    exposures: dict[str, list[Exposure]] = defaultdict(list)
    brackets = _brackets(stems)
    for path, stem in stems.items():
        base, seconds, stops = brackets.get(path, (stem, None, None))
        exposures[base].append(Exposure(path, seconds, stops))
    if stacks and config.stack.angles_deg:
        split: dict[str, tuple[str, float]] | None = _known_angles(exposures, config)
    else:
        split = _angles(list(exposures), config, exposures) if stacks else None
    if split is None:
        return [
            Group(b.replace("/", "_"), {None: tuple(e)})
            for b, e in sorted(exposures.items(), key=lambda i: i[0].replace("/", "_"))
        ], []
    views: dict[str, dict[float | None, tuple[Exposure, ...]]] = defaultdict(dict)
    rest: list[Path] = []
    for base, found in exposures.items():
        if base not in split:
            rest += [e.path for e in found]
            continue
        view, angle = split[base]
        views[view.replace("/", "_")][angle] = tuple(found)
    groups = [Group(view, dict(sorted(angles.items(), key=lambda i: i[0] or 0))) for view, angles in sorted(views.items())]
    return groups, sorted(rest)


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


def _known_angles(exposures: Mapping[str, list[Exposure]], config: CaptureConfig) -> dict[str, tuple[str, float]]:
    """VIEW and angle of every base name by capture.toml's endings. Raises UserError naming what they miss."""
    known, where = config.stack.angles_deg, config.path or Path("capture.toml")
    out, missed, used = {}, [], set()
    for base, found in exposures.items():
        ending = next((s for s in sorted(known, key=len, reverse=True) if base.endswith(s)), None)
        if ending is None:
            missed.append(found[0].path.name)
        else:
            used.add(ending)
            out[base] = (base[: -len(ending)].rstrip("_-/ ") or "view", turned(known[ending], config))
    idle = [repr(s) for s in known if s not in used]
    if not out:
        fault = f"stack.angles_deg: none of the {len(missed)} images ends in {', '.join(idle)} (first: {sorted(missed)[0]})"
        raise UserError(where, fault, "write the endings of the file names, without extension")
    if missed:
        fault = f"stack.angles_deg: no ending fits {len(missed)} of {len(exposures)} images ({some(sorted(missed))})"
        raise UserError(where, fault, "add their endings, or move these files away")
    if idle:
        raise UserError(where, f"stack.angles_deg: no image ends in {', '.join(idle)}", "correct the ending, or remove it")
    return out


def _angles(
    bases: list[str], config: CaptureConfig, exposures: Mapping[str, list[Exposure]]
) -> dict[str, tuple[str, float]] | None:
    """VIEW and angle of the base names, or None where the names are no stack; what fits none while most do is left out."""
    parsed = [{base: parse(base) for base in bases} for parse in (_by_suffix, _by_folder, _by_last_folder)]
    for split in parsed:
        sure = {b: s for b, s in split.items() if s is not None}
        if len(sure) == len(split) and _plausible(sure):
            return {b: (v, turned(a, config)) for b, (v, a) in sure.items()}
    for split in parsed:
        part = _stack_part({b: s for b, s in split.items() if s is not None})
        rest = [base for base in bases if base not in part]
        views = {view for view, _ in part.values()}
        apart = [b for b in rest if not any(_belongs(b, view) for view in views)]
        if not part or len(apart) > len(part) // 2:
            continue
        if len(apart) > FITTING * len(part):
            names = some(sorted(exposures[b][0].path.name for b in apart))
            fault = f"{len(part)} files make angle stacks, {len(apart)} do not ({names})"
            raise UserError(exposures[apart[0]][0].path.parent, fault, "move the ones that are no part of a stack away")
        return {b: (v, turned(a, config)) for b, (v, a) in part.items()}
    return None


FITTING = 0.25
"""Of the files in stacks: so many others may lie beside them and be left out; more are too many to be strays."""


def _belongs(base: str, view: str) -> bool:
    """Whether a file's name is a view's name with something added."""
    return base == view or (base.startswith(view) and not base[len(view)].isalnum())


def _stack_part(split: Mapping[str, tuple[str, float]]) -> dict[str, tuple[str, float]]:
    """Those of the parsed names whose views have the usual angles of the others; empty where they are no stack."""
    by_view: dict[str, list[float]] = defaultdict(list)
    for view, angle in split.values():
        by_view[view].append(angle)
    sets = Counter(frozenset(angles) for angles in by_view.values())
    if not sets:
        return {}
    most = max(sets, key=lambda s: (len(s) >= 3, sets[s], len(s)))
    fitting = {b: (v, a) for b, (v, a) in split.items() if set(by_view[v]) <= most}
    return fitting if fitting and _plausible(fitting) else {}


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
    if not sets:
        return False
    most = max(sets, key=lambda s: sum(frozenset(a) == s for a in by_view.values()))
    if any(len(set(a)) != len(a) for a in by_view.values()) or not are_angles(most):
        return False
    alike = sum(s <= most for s in map(frozenset, by_view.values()))
    if alike < 0.9 * len(by_view):
        return False
    return len(by_view) > 1 or most in USUAL


def are_angles(numbers: Collection[float]) -> bool:
    """Whether numbers are polariser angles and no counts: three or more up to 180, in steps of MIN_STEP_DEG and more."""
    return len(numbers) >= 3 and max(numbers) <= 180 and bool(np.diff(sorted(numbers)).min() >= MIN_STEP_DEG)


def turned(angle: float, config: CaptureConfig) -> float:
    """The file's angle as ours: counter-clockwise from the image's x axis."""
    return (-angle if config.stack.clockwise else angle) + config.stack.zero_deg
