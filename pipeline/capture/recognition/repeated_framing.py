"""Several pictures of each view, told apart by a word of their names: angles or exposures that are not named so."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Callable, Sequence
from pathlib import Path

from pipeline.capture.naming.files import count, some
from pipeline.capture.recognition.one_framing import FEWEST, stays_in_place

FEWEST_NAMES, MOST_NAMES = 3, 12
"""Pictures of a view; two are a pair of cameras as a rule."""
LOOKED_AT = 3
"""Views whose pictures are compared."""
LAST_WORD = re.compile(r"^(.+)[_\- ]([^_\- ]+)$")

Split = Callable[[str], tuple[str, str] | None]


def repeated_framing_words(paths: Sequence[Path], folder: Path) -> list[str]:
    """A warning where the pictures `paths` below `folder` are several of each view (or, where they are few, of one), which
    stays in place in them; else none."""
    stems = {path.relative_to(folder).with_suffix("").as_posix(): path for path in paths}
    for split in (_last_word, _first_folder, _last_folder):
        sets = _full_sets(stems, split)
        if sets and all(stays_in_place([found[name] for name in sorted(found)]) for found in list(sets.values())[:LOOKED_AT]):
            names = sorted(next(iter(sets.values())))
            fault = f"{count(paths, 'picture')} are taken as a view each, but those that differ in {some(names)} alone"
            return [
                f"{folder}: {fault} show one framing ({len(sets)} of them): angles or exposures? Name the angles "
                "under [stack.angles_deg] in capture.toml, exposures as _ev+1, or check that they are views"
            ]
    if FEWEST_NAMES <= len(paths) < FEWEST and stays_in_place(sorted(paths)):
        return [
            f"{folder}: its {len(paths)} pictures show one framing, in which light becomes brighter or darker and nothing "
            "moves: angles, exposures or lights of one view? Name them so, or check that they are views"
        ]
    return []


def _full_sets(stems: dict[str, Path], split: Split) -> dict[str, dict[str, Path]]:
    """{view: {word: file}} where two views or more have the same few words, and no file is left; else empty."""
    sets: dict[str, dict[str, Path]] = defaultdict(dict)
    for stem, path in stems.items():
        parts = split(stem)
        if parts is None:
            return {}
        sets[parts[0]][parts[1]] = path
    words = {frozenset(found) for found in sets.values()}
    fits = len(sets) > 1 and len(words) == 1 and all(FEWEST_NAMES <= len(w) <= MOST_NAMES for w in words)
    return dict(sets) if fits else {}


def _last_word(stem: str) -> tuple[str, str] | None:
    match = LAST_WORD.match(stem)
    return (match[1], match[2]) if match and "/" not in match[2] else None


def _first_folder(stem: str) -> tuple[str, str] | None:
    first, _, rest = stem.partition("/")
    return (rest, first) if rest else None


def _last_folder(stem: str) -> tuple[str, str] | None:
    folder, _, name = stem.rpartition("/")
    return (folder, name) if folder else None
