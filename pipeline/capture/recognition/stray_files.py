"""Files among a capture's images that are no views: previews, masks, products, calibration frames, thumbnails, twins.

A name alone is never enough, as an object may be called "mask": a file is left out where its name says what it is *and*
other pictures, without such a word, stay; of a whole set named alike nothing is left out.
"""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

from pipeline.capture.naming.files import IMAGE_FOLDERS, RAW_SUFFIXES, some
from pipeline.errors import UserError
from pipeline.formats.images import image_size

MAPS, MASKS = "ground truth and maps", "masks"
PRODUCTS = "polarisation products (DoLP, AoLP, Stokes or unpolarised pictures)"
KINDS: Mapping[str, str] = {
    "previews and thumbnails": "preview previews thumb thumbs thumbnail thumbnails proxy proxies contactsheet screenshot eadir",
    PRODUCTS: ("dolp aolp dop aop docp stokes s0 s1 s2 unpol unpolarised unpolarized nopol nopolariser nopolarizer"),
    "calibration pictures": (
        "checkerboard checkerboards chessboard chessboards checker charuco calib calibration calibrations colorchecker "
        "colourchecker macbeth greycard graycard"
    ),
    "dark, flat and bias frames": (
        "dark darkframe darks darkframes flat flatfield flats flatfields bias blackframe blackframes"
    ),
    MASKS: "mask masks matte mattes silhouette silhouettes segmentation trimap",
    MAPS: "gt groundtruth normal normals normalmap depth depths depthmap disparity albedo roughness",
}
"""What a word in a name says of a file."""
WORDS = {word: kind for kind, words in KINDS.items() for word in words.split()}
WEAK = frozenset({"dark", "flat", "normal", "depth", "proxy", "bias", "stokes", "s0", "s1", "s2"})
"""Words that name objects and sides of objects too: they count where few files, or files of a view, bear them."""
FEW = 0.25
"""Of the other files."""
TWINS = frozenset({".jpg", ".jpeg", ".heic", ".heif"})
SMALLER = 0.75
"""Of a picture's width, below which a file of its name with a word added is a copy for eyes and not another view."""


@dataclass(frozen=True)
class Sorted:
    """The pictures that are kept, and what was left out by reason."""

    kept: list[Path]
    left_out: Mapping[str, tuple[Path, ...]]

    def warnings(self) -> list[str]:
        """A line for each kind of file that was left out."""
        return [left_out_line(paths, reason) for reason, paths in self.left_out.items()]


def left_out_line(paths: Iterable[Path], reason: str) -> str:
    """The warning that names files which were left out."""
    listed = sorted(paths)
    remedy = "move them out of the image folder, or check that they are no views"
    if reason == MASKS:
        remedy = "to use them, put them into masks/, named like their views"
    return f"{listed[0].parent}: left out {some(p.name for p in listed)}: {reason}; {remedy}"


def sort_out(paths: list[Path], folder: Path, named_views: Collection[str] = ()) -> Sorted:
    """Views and strangers among the image files `paths` below `folder`, by name and, for copies, by size.

    named_views: stems of the images that a camera table names; these are views whatever they are called.
    """
    left_out: dict[str, list[Path]] = defaultdict(list)
    kept = _without_twins(paths, left_out)
    named = {path: word for path in kept if path.stem not in named_views and (word := telling_word(path, folder)) is not None}
    plain = [path for path in kept if path not in named]
    if named and _stands_apart(named, plain):
        for path, word in named.items():
            left_out[WORDS[word]].append(path)
        kept = plain
    kept = _without_copies(kept, named_views, left_out)
    return Sorted(kept, {reason: tuple(sorted(found)) for reason, found in left_out.items()})


def refuse_products(paths: Collection[Path], folder: Path) -> None:
    """Raise UserError where all pictures are Stokes components, DoLP or AoLP, several of each view: no pictures of light."""
    words = {path: telling_word(path, folder) for path in paths}
    found = sorted({word for word in words.values() if word is not None and WORDS[word] == PRODUCTS})
    if len(found) > 1 and all(word in found for word in words.values()):
        fault = f"holds nothing but {PRODUCTS}: {', '.join(found)}, and no picture tells their scale and zero"
        remedy = "give the pictures behind each angle, or Stokes vectors as EXR with channels S0.R .. S2.B (docs/captures.md)"
        raise UserError(folder, fault, remedy)


def words_of(name: str) -> list[str]:
    """The words of a name, lower case: runs of letters, their camelCase parts, neighbours joined (dark_frame), S0 to S2."""
    runs = re.findall(r"[^\W\d_]+", name)
    parts = [part for run in runs for part in re.findall(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])", run)]
    joined = [a + b for a, b in pairwise(runs)]
    stokes = re.findall(r"(?:^|[^a-zA-Z])([sS][012])(?![\da-zA-Z])", name)
    return [word.lower() for word in (*runs, *parts, *joined, *stokes)]


def telling_word(path: Path, folder: Path) -> str | None:
    """The word of a file's name, or of a folder between it and the image folder, that says that it is no view."""
    relative = path.relative_to(folder) if path.is_relative_to(folder) else Path(path.name)
    for part in (*relative.parts[:-1], relative.stem):
        if part not in IMAGE_FOLDERS:
            found = [word for word in words_of(part) if word in WORDS]
            if found:
                return min(found, key=lambda word: word in WEAK)
    return None


def folder_of_products(path: Path, root: Path) -> bool:
    """Whether a folder between a file and `root` is named after previews, masks, maps or other products of images."""
    words = [word for part in path.relative_to(root).parts[:-1] for word in words_of(part) if word in WORDS]
    return any(word not in WEAK or WORDS[word] == MAPS for word in words)


def _stands_apart(named: Mapping[Path, str], plain: list[Path]) -> bool:
    """Whether files with a telling word lie beside a set without: fewer than it, or each belonging to one of its files."""
    if not plain:
        return False
    limit = FEW * len(plain) if all(word in WEAK for word in named.values()) else len(plain)
    if len(named) < limit:
        return True
    stems = {_joined(p.stem) for p in plain}
    return all(_of_a_view(path.stem, word, stems) for path, word in named.items())


def _joined(stem: str) -> str:
    """A name with one kind of separator, and none at its ends."""
    return re.sub(r"[\W_]+", "_", stem.lower()).strip("_")


def _of_a_view(stem: str, word: str, views: Collection[str]) -> bool:
    """Whether a name, the telling word taken out, begins the name of a view (000_dolp: 000, or 000_045 of a stack)."""
    rest = _joined(re.sub(re.escape(word), "", stem, count=1, flags=re.IGNORECASE))
    return bool(rest) and any(view == rest or view.startswith(rest + "_") for view in views)


def _without_twins(paths: list[Path], left_out: dict[str, list[Path]]) -> list[Path]:
    """The files less the JPEGs that a camera wrote beside its raw files (same name, same folder or one named after them)."""
    raw = {(p.parent, p.stem.lower()) for p in paths if p.suffix.lower() in RAW_SUFFIXES}
    raw_names = {stem for _, stem in raw}
    kept = []
    for path in paths:
        twin = path.suffix.lower() in TWINS and (
            (path.parent, path.stem.lower()) in raw
            or (path.parent.name.lower() in ("jpg", "jpeg", "jpegs", "jpgs") and path.stem.lower() in raw_names)
        )
        if twin:
            left_out["the camera's own JPEGs of its raw files, which are used"].append(path)
        else:
            kept.append(path)
    return kept


def _without_copies(paths: list[Path], named_views: Collection[str], left_out: dict[str, list[Path]]) -> list[Path]:
    """The files less smaller pictures that have another's name with a word added (IMG_1_small.jpg, IMG_1-web.jpg)."""
    stems = {(p.parent, p.stem): p for p in paths}
    kept = []
    for path in paths:
        match = re.match(r"^(.+?)[_\-. ](?:[a-zA-Z]+|\d+x\d+)$", path.stem)
        whole = stems.get((path.parent, match.group(1))) if match else None
        if whole is not None and path.stem not in named_views and _much_smaller(path, whole):
            left_out["smaller copies of other pictures"].append(path)
        else:
            kept.append(path)
    return kept


def _much_smaller(path: Path, whole: Path) -> bool:
    try:
        (w, h), (width, height) = image_size(path), image_size(whole)
    except UserError:  # a damaged file: its reader says so
        return False
    return w < SMALLER * width and h < SMALLER * height
