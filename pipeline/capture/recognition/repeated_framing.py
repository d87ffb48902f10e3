"""Several pictures of each view, told apart by a word of their names: angles or exposures that are not named so."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Callable, Sequence
from pathlib import Path

from pipeline.capture.naming.files import some
from pipeline.capture.recognition.one_framing import FEWEST, what_changes

FEWEST_NAMES, MOST_NAMES = 2, 12
"""Pictures of a view; two are a pair of cameras as a rule, in which things move."""
FEWEST_ANGLES = 3
"""Of a polariser, that tell a Stokes vector."""
FEWEST_FEW = 3
"""Pictures of one framing, where they are all: two tell too little."""
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
        looked = [[found[name] for name in sorted(found)] for found in list(sets.values())[:LOOKED_AT]]
        kinds = [what_changes(pictures) for pictures in looked]
        light = "light" in kinds  # of which some come from behind
        if sets and kinds.count(None) <= (len(kinds) // LOOKED_AT if light else 0):
            names = sorted(next(iter(sets.values())))
            return [_several_of_each(folder, names, len(sets), len(paths), light)]
    kind = what_changes(sorted(paths)) if FEWEST_FEW <= len(paths) < FEWEST else None
    if kind == "gain":
        return [
            f"{folder}: its {len(paths)} pictures show one framing, in which light becomes brighter or darker and nothing "
            "moves: angles, exposures or lights of one view? Name them so, or check that they are views"
        ]
    if kind == "light":
        return [
            f"{folder}: its {len(paths)} pictures show one framing under changing light: lights of a light stage that lacks "
            "its light table, and no views, of which a model needs eight; add the table (docs/light_stage.md), or check that "
            "they are views"
        ]
    return []


def _several_of_each(folder: Path, names: Sequence[str], sets: int, paths: int, light: bool) -> str:
    fault = f"{paths} pictures are taken as a view each, but those that differ in {some(names)} alone show one framing"
    if light:
        remedy = (
            " under changing light: a light stage's? It needs a light table (docs/light_stage.md); or check that they are views"
        )
    elif len(names) < FEWEST_ANGLES:
        remedy = ": two angles of a polariser? A third makes Stokes vectors of them; of two, give one as the views"
    else:
        remedy = (
            ": angles or exposures? Name the angles under [stack.angles_deg] in capture.toml, exposures as _ev+1, or check "
            "that they are views"
        )
    return f"{folder}: {fault} ({sets} of them){remedy}"


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
