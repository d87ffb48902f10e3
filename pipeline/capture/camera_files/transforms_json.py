"""nerfstudio's and NeRF's tables: transforms.json, or one a part (train, val, test), and the images that they name."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any

from pipeline.capture.camera_files.table import entries_of, stem_parts
from pipeline.capture.naming.beside_images import images_by_name
from pipeline.capture.naming.files import IMAGE_SUFFIXES, image_folder, subfolders
from pipeline.capture.recognition.stray_files import sort_out
from pipeline.errors import UserError
from pipeline.formats.json_file import read_json

FILE = "transforms.json"
PARTS = {"transforms_train.json": "train", "transforms_val.json": "validation", "transforms_test.json": "test"}
LONGEST_NAME = 4096  # Linux's PATH_MAX
FEWEST = 4
"""Views that training needs: parts that leave fewer to it hold none out."""


@dataclass(frozen=True)
class NerfFrame:
    """A frame's entry, the table that it stands in, the file that it means, and its part ("" where none is named)."""

    entry: dict[str, Any]
    table: dict[str, Any]
    where: Path
    path: Path
    part: str = ""


def table_files(root: Path) -> list[Path]:
    """The tables of a capture: its transforms.json, else those of the parts; else those of the one folder that has some."""
    here = _in_folder(root)
    if here:
        return here
    below = [found for p in subfolders(root) if (found := _in_folder(p))]
    return below[0] if len(below) == 1 else []


def captures_below(root: Path) -> list[Path]:
    """Folders below `root` with tables of their own, where there are several: each is a capture."""
    below = [p for p in subfolders(root) if _in_folder(p)]
    return below if len(below) > 1 else []


def _in_folder(folder: Path) -> list[Path]:
    if (folder / FILE).exists():
        return [folder / FILE]
    return [folder / name for name in PARTS if (folder / name).exists()]


def load_frames(files: list[Path]) -> list[NerfFrame]:
    """Every frame of the tables with the file that it means. Raises UserError on a table that is damaged."""
    frames = []
    for where in files:
        table = load_table(where)
        parts = _parts_of(where, table)
        for entry in table["frames"]:
            name = entry["file_path"]
            frames.append(NerfFrame(entry, table, where, _as_named(where.parent, name), parts(name)))
    if not any(f.path.is_file() for f in frames):
        frames = _by_name(files[0].parent, frames)
    return frames


def _parts_of(where: Path, table: dict[str, Any]) -> Any:
    """The part of a file_path: the table's own, or by nerfstudio's lists of file names, or by a table of test views beside."""
    if where.name in PARTS:
        return lambda name: PARTS[where.name]
    test = {stem_parts(n) for n in table.get("test_filenames") or () if isinstance(n, str)}
    validation = {stem_parts(n) for n in table.get("val_filenames") or () if isinstance(n, str)}
    beside = where.parent / "transforms_test.json"
    if not test and beside.is_file():
        test = {stem_parts(f["file_path"]) for f in load_table(beside)["frames"]}
    if not test:
        return lambda name: ""
    return lambda name: "test" if stem_parts(name) in test else "validation" if stem_parts(name) in validation else "train"


def held_out(parts: dict[str, str]) -> dict[str, str] | None:
    """The part of each VIEW, or None where the tables hold no test view or leave too few to training."""
    if "test" not in parts.values() or sum(p in ("train", "") for p in parts.values()) < FEWEST:
        return None
    return {view: part or "train" for view, part in parts.items()}


def _as_named(base: Path, name: str) -> Path:
    """The file of a file_path: as named, with an image extension, or with Windows separators read as such."""
    path = existing(base / name)
    if path.is_file() or "\\" not in name:
        return path
    plain = name.replace("\\", "/")
    return path if re.match(r"^[A-Za-z]:", plain) else existing(base / PurePosixPath(plain))


def existing(path: Path) -> Path:
    """The file that a frame means: as named, or with one of the image extensions."""
    if path.is_file():
        return path
    return next((q for q in (path.with_name(path.name + s) for s in sorted(IMAGE_SUFFIXES)) if q.is_file()), path)


def _by_name(base: Path, frames: list[NerfFrame]) -> list[NerfFrame]:
    """Frames whose paths are another machine's (or another folder's), matched with the capture's images by name."""
    folder = image_folder(base)
    images = sort_out(images_by_name(base, folder), folder).kept
    names = [f.entry["file_path"] for f in frames]
    found = entries_of(names, {p.as_posix(): (p,) for p in images}, folder)
    by_entry = {index: Path(name) for name, index in found.items()}
    return [NerfFrame(f.entry, f.table, f.where, by_entry.get(i, f.path), f.part) for i, f in enumerate(frames)]


def load_table(path: Path) -> dict[str, Any]:
    """The parsed transforms.json with at least one frame. Raises UserError."""
    table = read_json(path)
    frames = table.get("frames") if isinstance(table, dict) else None
    if not isinstance(frames, list) or not frames:
        raise UserError(path, "holds no frames", 'it needs "frames": [{"file_path", "transform_matrix"}, ...]')
    for frame in frames:
        if not isinstance(frame, dict) or not isinstance(frame.get("file_path"), str) or not frame["file_path"]:
            raise UserError(path, "a frame has no file_path", "name the image of every frame")
        if not isinstance(frame.get("mask_path") or "", str):
            fault = f"frame {frame['file_path']}: mask_path = {frame['mask_path']!r} is not text"
            raise UserError(path, fault, "name the frame's mask, or leave it out")
        for key in ("file_path", "mask_path"):
            if len(frame.get(key) or "") > LONGEST_NAME or "\0" in (frame.get(key) or ""):
                raise UserError(path, f"a frame's {key} is no file name ({frame[key][:40]!r}...)", "name the frame's file")
    return table
