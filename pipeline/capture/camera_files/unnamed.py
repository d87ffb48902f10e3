"""What looks like cameras under a name or in a place where none are looked for: named, as it is not read."""

from __future__ import annotations

import os
import re
from collections.abc import Collection, Sequence
from pathlib import Path

from pipeline.capture.naming.files import list_images, some, subfolders
from pipeline.errors import UserError
from pipeline.formats.arrays import array_names, array_shape
from pipeline.formats.colmap import FILES, holds_model

TEXT = frozenset({".txt", ".json", ".jsonl", ".csv", ".tsv", ".xml", ".xmp", ".yaml", ".yml", ".cam", ".out", ".log", ".dat"})
LARGEST, MOST_FILES = 1 << 24, 200
"""Bytes of a file that is looked into, and files of a folder."""
A_POSE = 6
"""Numbers a picture, at least: a place and three angles. An exposure or a time is one."""
NUMBER = re.compile(rb"[-+]?\d+\.\d+(?:[eE][-+]?\d+)?")
"""With a point: counts, times and names of files are none."""
MATRICES = ((4, 4), (3, 4), (3, 5))
SHARE = 0.5
"""Of the pictures, that are named or have a file each."""
IF = "if these are cameras, convert them to transforms.json (docs/captures.md lists what is read)"


def cameras_under_other_names(root: Path, folder: Path) -> list[str]:
    """Say what beside the images looks like their cameras and is not read.

    Args:
        root: the capture's folder.
        folder: that of its images.

    Returns:
        A line for each kind; empty where nothing looks so.
    """
    try:
        pictures = list_images(folder)
    except UserError:  # its reader says so
        return []
    homes = subfolders(root)
    places = [root, *homes, *(q for p in homes for q in subfolders(p))][:MOST_FILES]
    found = [*_models(places), *_half_models(root), *_tables(places), *_a_file_each(places, {p.stem for p in pictures})]
    found = found or _arrays(places, len(pictures)) or _naming_all(places, [p.name for p in pictures])
    return found or _calibrations(places)


def _models(places: Sequence[Path]) -> list[str]:
    """COLMAP models that lie elsewhere."""
    there = [p for p in places if holds_model(p)]
    return [f"{p}: a COLMAP model is not looked for here; to use it, move it to sparse/0 beside the images" for p in there[:1]]


def _half_models(root: Path) -> list[str]:
    """A folder for COLMAP's models without a whole one."""
    for place in (p for name in ("sparse", "colmap") for p in (root / name, *sorted((root / name).glob("*"))) if p.is_dir()):
        parts = sorted(p.name for p in place.iterdir() if p.stem in FILES)
        if parts and not holds_model(place):
            return [f"{place}: holds {some(parts)} and no whole model (cameras and images, both .bin or .txt): export it again"]
    return []


def _tables(places: Sequence[Path]) -> list[str]:
    """Files like a transforms.json under another name."""
    for path in _texts(places):
        if path.suffix.lower() == ".json" and (text := _text(path)) and b'"frames"' in text and b'"transform_matrix"' in text:
            return [f"{path}: looks like a table of cameras and is not read; to use it, call it transforms.json"]
    return []


def _a_file_each(places: Sequence[Path], stems: Collection[str]) -> list[str]:
    """A folder with a file of a pose's numbers for most pictures; of XMP, which converters write too, RealityCapture's."""
    for place in places:
        files = [p for p in sorted(place.iterdir()) if p.suffix.lower() in TEXT and p.stem in stems and p.is_file()]
        if len(files) > SHARE * len(stems) and all(_holds_pose(p) for p in (files[0], files[-1])):
            return [f"{place}: a file of numbers for each picture ({some(p.name for p in files)}) is not read; {IF}"]
    return []


def _holds_pose(path: Path) -> bool:
    text = _text(path)
    return b"xcr:Rotation" in text if path.suffix.lower() == ".xmp" else len(NUMBER.findall(text)) >= A_POSE


def _arrays(places: Sequence[Path], pictures: int) -> list[str]:
    """NumPy files with a matrix a picture, as one array or one array each."""
    for path in (p for place in places for p in sorted(place.glob("*.np[yz]"))[:MOST_FILES] if not p.name.startswith(".")):
        try:
            keys: list[str | None] = [*array_names(path)][: 2 * pictures + 2] if path.suffix == ".npz" else [None]
            shapes = [array_shape(path, key) for key in keys]
        except UserError:
            continue
        each = sum(shape in MATRICES for shape in shapes)
        if each >= pictures or any(shape[:1] == (pictures,) and shape[1:] in MATRICES for shape in shapes):
            return [f"{path}: holds a matrix for each picture and is not read; {IF}"]
    return []


def _naming_all(places: Sequence[Path], names: Sequence[str]) -> list[str]:
    """A text file that names most pictures (by file, or without ending where the name has letters) and has poses' numbers."""
    words = [os.fsencode(name if Path(name).stem.isdigit() else Path(name).stem) for name in names]
    for path in _texts(places):
        text = _text(path)
        if len(NUMBER.findall(text)) >= A_POSE * SHARE * len(names) and sum(w in text for w in words) > SHARE * len(names):
            return [f"{path}: names the pictures, with numbers for each, and is not read; {IF}"]
    return []


def _calibrations(places: Sequence[Path]) -> list[str]:
    """A lens calibration, as OpenCV and its wrappers write it."""
    for path in _texts(places):
        if any(word in _text(path) for word in (b"camera_matrix", b"cameraMatrix", b"CameraMatrix", b"opencv-matrix")):
            use = "undistort the pictures with it, or set poses.focal_px in capture.toml"
            return [f"{path}: looks like the calibration of a lens and is not read; to use it, {use}"]
    return []


def _texts(places: Sequence[Path]) -> list[Path]:
    found = [p for place in places for p in sorted(place.iterdir())[:MOST_FILES] if p.suffix.lower() in TEXT]
    return [p for p in found if not p.name.startswith(".") and p.is_file()]


def _text(path: Path) -> bytes:
    """What a file holds; nothing where it is large or cannot be read."""
    try:
        return path.read_bytes() if path.stat().st_size <= LARGEST else b""
    except OSError:
        return b""
