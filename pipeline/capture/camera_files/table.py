"""A file of cameras, understood: its entries by image name or by order, and which entry belongs to which view."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path, PurePosixPath

from pipeline.capture.model import ViewSource
from pipeline.capture.naming.files import IMAGE_SUFFIXES, count, some
from pipeline.capture.naming.grouping import Group
from pipeline.errors import UserError
from pipeline.geometry.camera_check import check_camera
from pipeline.geometry.cameras import Camera

Size = tuple[int, int]


@dataclass(frozen=True)
class CameraTable:
    """Cameras of one file or folder `path`, a `title` for the user.

    names: the image of each entry, as told; None: the entries are in the order of the sorted images. camera(i, size):
    entry i for an image of (width, height) pixels. numbers: of entries in order, where the file numbers them. model: a
    COLMAP folder, which has points too.
    """

    path: Path
    title: str
    names: tuple[str, ...] | None
    length: int
    camera: Callable[[int, Size], Camera] = field(repr=False, compare=False)
    files: tuple[Path, ...] = ()
    numbers: tuple[int, ...] = ()
    model: Path | None = None
    warnings: tuple[str, ...] = ()
    facts: tuple[str, ...] = ()

    def checked(self, index: int, size: Size) -> Camera:
        """`camera`, if it can be one. Raises UserError on the file, naming the entry."""
        what = f"camera {index}" if self.names is None else f"image {self.names[index]}"
        return check_camera(self.camera(index, size), self.path, what)

    def named(self, group: Group, folder: Path) -> bool:
        """Whether the table has a camera for a view; always where it goes by order."""
        if self.names is None:
            return True
        return bool(entries_of(self.names, {group.view: group.paths}, folder))


def cameras_of_views(table: CameraTable, views: Sequence[ViewSource], folder: Path) -> tuple[dict[str, Camera], list[str]]:
    """Cameras by VIEW, and warnings for views without a camera and cameras without an image. Raises UserError."""
    if table.names is None:
        entry = entries_in_order(table, [v.view for v in views])
    else:
        entry = entries_of(table.names, {v.view: v.paths for v in views}, folder)
        if not entry:
            fault = f"none of its images is here (first: {table.names[0] if table.names else '-'})"
            raise UserError(table.path, fault, f"give the images the names that the {table.title} tells")
    cameras = {}
    for view in views:
        if view.view in entry:
            found = table.checked(entry[view.view], view.size or (0, 0))
            cameras[view.view] = replace(fitted(found, view, table), name=view.camera)
    missing = [v.view for v in views if v.view not in cameras]
    warnings = list(table.warnings)
    if missing:
        warnings.append(f"{table.path}: no camera for {count(missing, 'view')} ({some(missing)}); left out")
    if table.length > len(cameras):
        warnings.append(f"{table.path}: no image for {table.length - len(cameras)} of its cameras; left out")
    return cameras, warnings


def fitted(camera: Camera, view: ViewSource, table: CameraTable) -> Camera:
    """The camera for the picture's size: scaled where the picture is, refused where its shape differs."""
    if view.size is None or (camera.width, camera.height) == view.size:
        return camera
    width, height = view.size
    if abs(camera.width * height - camera.height * width) > max(camera.width, camera.height):
        have, want = f"{width}x{height}", f"{camera.width}x{camera.height}"
        fault = f"is {have}, its {table.title} camera {want}"
        raise UserError(view.paths[0], fault, "use the images that the cameras were found from, unrotated")
    return camera.resized(width, height)


def stem_parts(name: str) -> tuple[str, ...]:
    """The parts of an image's name in a table, without extension: Windows separators, drives and ./ understood."""
    plain = re.sub(r"^[A-Za-z]:", "", name.replace("\\", "/"))
    path = PurePosixPath(plain)
    if path.suffix.lower() in IMAGE_SUFFIXES:
        path = path.with_suffix("")
    return tuple(p for p in path.parts if p not in ("/", ".", ".."))


def entries_of(names: Sequence[str], paths: Mapping[str, Iterable[Path]], folder: Path) -> dict[str, int]:
    """Which entry of `names` each view's files are: by the longest common end of the path; an entry serves one view.

    A name that fits several entries equally well fits none.
    """
    tails: dict[tuple[str, ...], set[int]] = defaultdict(set)
    for index, name in enumerate(names):
        parts = stem_parts(name)
        for k in range(1, len(parts) + 1):
            tails[parts[-k:]].add(index)
    best: list[tuple[int, str, int]] = []
    for view, files in paths.items():
        stems = [tuple(p.relative_to(folder.parent).with_suffix("").parts) for p in files] + [(view,)]
        found = [(k, i) for stem in stems for k in range(1, len(stem) + 1) for i in _one(tails.get(stem[-k:]))]
        if found:
            longest = max(found)
            best.append((longest[0], view, longest[1]))
    out: dict[str, int] = {}
    used: set[int] = set()
    for _, view, index in sorted(best, key=lambda b: (-b[0], b[1])):
        if index not in used:
            used.add(index)
            out[view] = index
    return out


def _one(found: set[int] | None) -> list[int]:
    return list(found) if found is not None and len(found) == 1 else []


def entries_in_order(table: CameraTable, views: list[str]) -> dict[str, int]:
    """Entries to views in sorted order, or by number where counts differ and the file numbers its entries."""
    if len(views) == table.length:
        return {view: index for index, view in enumerate(sorted(views))}
    digits = {view: "".join(c for c in view if c.isdigit()) for view in views}
    number = {view: int(d) for view, d in digits.items() if d}
    if len(set(number.values())) == len(views) and set(number.values()) <= set(table.numbers):
        return {view: table.numbers.index(k) for view, k in number.items()}
    fault = f"holds {count(range(table.length), 'camera')} for {count(views, 'view')}, in the order of the images"
    raise UserError(table.path, fault, "give each view its camera, or move the file away to find the cameras anew")
