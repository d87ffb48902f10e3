"""Files that nobody here reads beside those that are, and folders with nothing else: named, with the way out."""

from __future__ import annotations

import os
from collections import defaultdict
from pathlib import Path

from pipeline.capture.model import Capture
from pipeline.capture.naming.files import (
    ARCHIVES,
    DUMPS,
    FLOAT_SUFFIXES,
    IMAGE_FOLDERS,
    IMAGE_SUFFIXES,
    UNREADABLE,
    count,
    some,
)
from pipeline.errors import UserError

MOST_LOOKED_AT = 20_000
LINK_LEVELS = 3
"""Folders deep: camNN/cross, images/CAMERA."""


def lost_links(root: Path) -> list[str]:
    """A line where the capture's folder, or those of a few levels below, hold links to nothing: what they stood for is taken as
    not given."""
    lost = sorted(_lost(root, LINK_LEVELS))
    if not lost:
        return []
    named = f"{count(lost, 'link')} to nothing ({some(p.relative_to(root).as_posix() for p in lost)})"
    return [f"{lost[0]}: {named}: copy what they stand for, or remove them"]


def _lost(folder: Path, levels: int) -> list[Path]:
    """Links to nothing in a folder and below; none that is hidden."""
    with os.scandir(folder) as listing:
        entries = [entry for entry in listing if not entry.name.startswith(".")]
    found = [Path(e.path) for e in entries if e.is_symlink() and not os.path.exists(e.path)]
    folders = [Path(e.path) for e in entries if levels > 1 and e.is_dir(follow_symlinks=False)]
    below = [path for path in folders if os.access(path, os.R_OK | os.X_OK)]
    return found + [path for place in below for path in _lost(place, levels - 1)]


def foreign_warnings(capture: Capture) -> list[str]:
    """A line for each kind of unreadable file among the images, and one for macOS' resource files."""
    folders = {path.parent for view in capture.views for path in view.paths}
    if capture.light_stage is not None:
        folders |= {p.parent for c in capture.light_stage.cameras.values() for p in (*c.cross, *c.parallel)}
    folders |= {p for p in (capture.root / "envmaps",) if p.is_dir()}
    kinds: dict[str, list[Path]] = defaultdict(list)
    resources: list[Path] = []
    for path in (p for folder in sorted(folders) for p in sorted(folder.iterdir())):
        if path.name.startswith("._"):
            resources.append(path)
        elif path.suffix.lower() in UNREADABLE and not path.name.startswith("."):
            kinds[UNREADABLE[path.suffix.lower()]].append(path)
    lines = [f"{found[0].parent}: left out {some(p.name for p in found)}: {way}" for way, found in kinds.items()]
    maps = _children(capture.root / "envmaps")
    used = {p.stem for p in maps if p.suffix.lower() in FLOAT_SUFFIXES}  # a picture of the same name is its preview
    idle = sorted(p.name for p in maps if p.suffix.lower() in IMAGE_SUFFIXES - FLOAT_SUFFIXES and p.stem not in used)
    if idle:
        lines.append(f"{capture.root / 'envmaps'}: left out {some(idle)}: a map is linear: give it as .hdr or .exr")
    if not capture.environments and capture.views and (beside := _maps_elsewhere(capture)):
        lines.append(f"{beside[0].parent}: holds {some(p.name for p in beside)}: to relight with it, name the folder envmaps/")
    if resources:
        named = some(p.name for p in resources)
        lines.append(f"{resources[0].parent}: left out {named}: macOS resource files, no images; delete them (dot_clean)")
    return lines


MAP_FOLDERS = frozenset({"env", "envs", "envmap", "env_maps", "environment", "environments", "hdri", "hdris", "hdr"})


def _maps_elsewhere(capture: Capture) -> list[Path]:
    """Maps in a folder whose name nearly says so, none of them a picture of a view."""
    used = {path for view in capture.views for path in view.paths}
    there = [q for p in _children(capture.root) if p.name.lower() in MAP_FOLDERS for q in sorted(_children(p))]
    return [p for p in there if p.suffix.lower() in FLOAT_SUFFIXES and p not in used]


def _children(folder: Path) -> list[Path]:
    return [p for p in folder.iterdir() if not p.name.startswith(".")] if folder.is_dir() else []


BESIDE_VIEWS = (
    "masks", "mask", "sparse", "colmap", "cameras*.npz", "cameras.xml", "*_par.txt", "bundle.out", "poses_bounds.npy",
)  # fmt: skip
"""What lies beside a capture's pictures and tells that there were some."""


def refuse_dataset(root: Path) -> None:
    """Raise UserError where a folder is what the stages write, not what they read."""
    if (root / "dataset.json").is_file() and any((root / name).exists() for name in ("in_use.json", "decode", "poses")):
        raise UserError(root, "is a dataset that was made from a capture", "give CAPTURE= the capture's own folder")


def refuse_without_pictures(root: Path) -> None:
    """Raise UserError where a folder holds cameras or masks and no picture of a view."""
    found = sorted(p.name + "/" * p.is_dir() for pattern in BESIDE_VIEWS for p in root.glob(pattern) if p.exists())
    if not found:
        return
    lost = [p.relative_to(root).as_posix() for p in sorted(_lost(root, LINK_LEVELS))]
    links = f" ({some(lost)} is a link to nothing)" if lost else ""
    raise UserError(root, f"holds {some(found)}, but no picture of a view{links}", "copy the pictures into images/")


def refuse_unreadable(root: Path) -> None:
    """Raise UserError naming the kind of file where a folder of no known layout holds pictures that are not read."""
    found: dict[str, list[Path]] = defaultdict(list)
    for number, path in enumerate(root.rglob("*")):
        if number > MOST_LOOKED_AT:
            break
        suffix = path.suffix.lower()
        if path.name.startswith(".") or suffix in IMAGE_SUFFIXES or not path.is_file():
            continue
        dump = suffix in DUMPS and (path.parent == root or path.relative_to(root).parts[0] in IMAGE_FOLDERS)
        if suffix in UNREADABLE or dump or suffix in ARCHIVES:
            found[suffix].append(path)
    if not found:
        return
    suffix, files = max(found.items(), key=lambda item: len(item[1]))
    files.sort()
    way = "unpack them" if suffix in ARCHIVES else "write the samples as 16-bit PNG or TIFF, one file a picture (lossless)"
    way = UNREADABLE.get(suffix, way)
    raise UserError(files[0], f"{suffix} files are not read, and there are no other images ({len(files)} of them)", way)
