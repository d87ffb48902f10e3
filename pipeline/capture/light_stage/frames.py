"""Which frame of a pass belongs to which light: by the names that a table tells, or by the frames' numbers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

import numpy as np
from numpy.typing import NDArray

from pipeline.capture.light_stage.frame_numbers import frame_files, numbered
from pipeline.capture.model import LightStageCamera
from pipeline.capture.naming.files import IMAGE_SUFFIXES, some
from pipeline.errors import UserError
from pipeline.rig.light_table import LightTable

LEADING_FRAMES = 2
"""A pass begins with two frames under all lights (tracking), then one frame a light; two more may follow."""


@dataclass(frozen=True)
class PassFrames:
    """The frames of a pass in the order of the lights, those under all lights (or dark), and those of lights left out."""

    frames: tuple[Path, ...]
    full_light: tuple[Path, ...] = ()
    left_out: tuple[Path, ...] = ()


def pass_frames(folder: Path, lights: LightTable, table: Path, first: int | None = None) -> PassFrames:
    """The frames of the pass in `folder` for the lights of `table`; `first`: the number of the frame of index 0, if known.

    Raises UserError when frames are missing, empty, or their numbers do not fit the table.
    """
    paths = frame_files(folder)
    named = frames_by_name(paths, lights.names, table)
    if named is not None:
        rest = tuple(p for p in paths if p not in set(named))
        return PassFrames(_not_empty(named), left_out=rest)
    found = numbered(paths)
    index = np.arange(len(lights)) if lights.index is None else lights.index
    offset = first if first is not None else frame_offset(index, sorted(found), folder, table)
    wanted = [int(i) + offset for i in index]
    missing = [k for k in wanted if k not in found]
    if missing:
        raise UserError(folder, f"lacks frame {some(map(str, missing), 5)} of {len(lights)} lights", "copy the missing frames")
    frames = tuple(found[k] for k in wanted)
    between = [k for k in found if min(wanted) < k < max(wanted) and k not in set(wanted)]
    outside = [k for k in sorted(found) if k < min(wanted) or k > max(wanted)]
    return PassFrames(_not_empty(frames), tuple(found[k] for k in outside), tuple(found[k] for k in sorted(between)))


def frame_offset(
    index: NDArray[np.int64], numbers: Sequence[int], folder: Path, table: Path, leading: int = LEADING_FRAMES
) -> int:
    """What is added to a light's index to get its frame's number. Raises UserError where the numbers leave it open.

    Frames may be 0..R-1; 2..R+1, with two leading and two trailing ones or without; 1..R; or named by index. R counts
    the rig's lights up to the last in the table: an index may be missing (a light that did not fire), so that light i
    is found by its index, never by its row. A pass that begins at 0 is whole or has no leading frames: a table that is a
    few rows short must not shift the lights by two. leading: how many frames under all lights a pass may begin with.
    """
    low, high = int(index.min()), int(index.max())
    first, last = numbers[0], numbers[-1]
    sure: set[int] = set()
    possible: set[int] = set()
    for base in {low} | {b for b in (0, 1) if b <= low}:
        count = high - base + 1
        if first == 0 and last == count - 1:
            sure.add(-base)
        elif leading and (first, last) in ((0, count + 2 * leading - 1), (leading, count + leading - 1)):
            sure.add(leading - base)
        elif first == 1 and last == count:
            sure.add(1 - base)
        elif leading and first > 0 and count + leading - 1 <= last < count + 2 * leading:
            possible.add(leading - base)
    if set(numbers) == set(index.tolist()) or (low > 1 and first == low and last == high):
        sure.add(0)
    chosen = sure or possible
    if len(chosen) == 1:
        return chosen.pop()
    rows = f"lists {len(index)} lights (index {low}..{high})"
    fault = f"{rows}, but {folder} has frames {first}..{last} ({len(numbers)} files)"
    remedy = "frames 0..N-1 or 2..N+1 belong to N lights: use the table that fits, or say which frame is the light of index 0"
    raise UserError(table, fault, f"{remedy}: first_frame = 2 under [olat] in capture.toml")


def frames_by_name(paths: list[Path], names: tuple[str, ...] | None, table: Path) -> tuple[Path, ...] | None:
    """The frames that a table names, in its order; None where it names none, or none of them is here by name.

    Raises UserError where it names one twice, or one that is not here while others are: by number or in order, as where no
    name tells, each light's frame might be another's.
    """
    if names is None:
        return None
    stems = {p.stem.lower(): p for p in paths}
    wanted = {_stem(name): name for name in names}
    lost = [name for stem, name in wanted.items() if stem not in stems]
    if len(lost) == len(wanted):
        return None
    if len(wanted) < len(names):
        twice = next(name for k, name in enumerate(names) if _stem(name) in map(_stem, names[:k]))
        raise UserError(table, f"names {twice} twice", "name each light's own picture")
    if lost:
        fault = f"names {some(lost)}, which {paths[0].parent} has not ({len(lost)} of {len(wanted)} lights)"
        raise UserError(table, fault, "correct the names, or copy the missing pictures")
    return tuple(stems[stem] for stem in wanted)


def _stem(name: str) -> str:
    path = PurePosixPath(name.replace("\\", "/"))
    return path.stem.lower() if path.suffix.lower() in IMAGE_SUFFIXES else path.name.lower()


def _not_empty(frames: tuple[Path, ...]) -> tuple[Path, ...]:
    empty = next((p for p in frames if p.stat().st_size == 0), None)
    if empty is not None:
        raise UserError(empty, "the file is empty (0 bytes)", "copy it again from its source")
    return frames


def left_out_fact(frames: dict[str, PassFrames]) -> list[str]:
    """What to say of frames whose lights are not in the table."""
    out = {p.name: None for found in frames.values() for p in found.left_out}
    return [f"frames of lights that the table leaves out are not used: {some(out)}"] if out else []


def one_pass_facts(cameras: Mapping[str, LightStageCamera]) -> list[str]:
    """What to say of cameras that have one pass."""
    apart = "; diffuse and specular light are told apart by the fit"
    kinds = {
        "cross": "frames behind crossed polarisers alone: diffuse light, no lobe",
        "parallel": f"frames behind parallel polarisers alone{apart}",
        "none": f"frames without polarisers{apart}",
    }
    found = {kind: [name for name, camera in cameras.items() if camera.passes == kind] for kind in kinds}
    return [f"{some(names)}: {kinds[kind]}" for kind, names in found.items() if names]
