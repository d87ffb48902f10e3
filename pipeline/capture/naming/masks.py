"""Masks that lie beside a capture's images, under any of the usual names, and what may be masks and is not read as such."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

from pipeline.capture.naming.files import (
    ASIDE,
    IMAGE_FOLDERS,
    MASK_FOLDERS,
    PHOTO_SUFFIXES,
    count,
    has_images,
    list_images,
    some,
)
from pipeline.capture.recognition.stray_files import MAPS, WORDS, words_of
from pipeline.errors import UserError
from pipeline.formats.images import channel_names, image_size, read_image

BETWEEN = 0.1
"""Share of a mask's samples that are neither black nor white, at most: soft edges."""


def mask_folders(root: Path) -> list[Path]:
    """Folders named as masks are, whatever their case, the usual names first."""
    found = [p for p in root.iterdir() if p.name.lower() in MASK_FOLDERS and p.is_dir()]
    return sorted(found, key=lambda p: (p.name not in MASK_FOLDERS, MASK_FOLDERS.index(p.name.lower()), p.name))


def masks_under_other_names(root: Path, views: Mapping[str, Path], folder: Path) -> list[str]:
    """A line where another folder holds a black and white picture for every view, as masks under another name are."""
    stems = {path.stem for path in views.values()}
    for place in sorted(p for p in root.iterdir() if p.is_dir() and not p.name.startswith(".")):
        maps = any(WORDS.get(word) == MAPS for word in words_of(place.name))
        if place.name.lower() in ASIDE or maps or folder.is_relative_to(place):
            continue
        pictures = sorted(p for p in place.iterdir() if p.suffix.lower() == ".png" and p.stem in stems)
        if len(pictures) >= max(2, len(stems)) and all(map(_is_black_and_white, pictures[:2])):
            return [f"{place}: a black and white picture for every view: if these are masks, name the folder masks/ (not used)"]
    return []


def _is_black_and_white(path: Path) -> bool:
    """Whether a picture has one channel, and hardly a sample between its darkest and its brightest."""
    if len(channel_names(path)) > 1:
        return False
    samples = read_image(path)
    low, high = float(samples.min()), float(samples.max())
    between = (samples > low + 0.1 * (high - low)) & (samples < high - 0.1 * (high - low))
    return high > low and float(between.mean()) < BETWEEN


def find_masks(root: Path, views: Mapping[str, Path], folder: Path) -> tuple[dict[str, Path], list[str]]:
    """Mask files by VIEW from masks/ or mask/, under any of the usual names, and warnings for views without one.

    `views` maps VIEW to its image, `folder` is the image folder. COLMAP's IMAGE.EXT.png is understood too.
    """
    between = [p for p in (folder, *folder.parents) if p != root and p.is_relative_to(root) and p.name not in IMAGE_FOLDERS]
    places = [place for home in (root, *between) for place in mask_folders(home)]
    where = next((place for place in places if has_images(place, PHOTO_SUFFIXES)), None)
    if where is None:
        idle = _refuse_unread(places)
        return {}, [*idle, *masks_under_other_names(root, views, folder), *_lone_mask(root, folder)]
    by_stem: dict[str, Path] = {}
    for path in list_images(where, PHOTO_SUFFIXES):
        name = path.relative_to(where).with_suffix("").as_posix()
        if by_stem.setdefault(name, path) != path:
            raise UserError(path, f"is the mask of the same view as {by_stem[name].name}", "remove one of them")
        by_stem.setdefault(name.replace("/", "_"), path)
    found: dict[str, Path] = {}
    for view, image in views.items():
        relative = image.relative_to(folder)
        for stem in (relative.with_suffix("").as_posix(), relative.as_posix(), view):
            if stem in by_stem:
                found[view] = by_stem[stem]
                break
    if not found:
        sample = list_images(where, PHOTO_SUFFIXES)[0].name
        first = next(iter(views.values())).name
        raise UserError(
            where, f"none of its masks belongs to an image (mask {sample}, image {first})", "name each mask like its image"
        )
    missing = sorted(set(views) - set(found))
    warnings = []
    if missing:
        fault = f"no mask for {count(missing, 'view')} ({some(missing)})"
        shifted = len(set(by_stem.values())) == len(views) and len(missing) < len(views) / 2
        doubt = " (as many masks as views: are they counted from another number, and each mask the next view's?)" * shifted
        warnings.append(f"{where}: {fault}; they are segmented: check the names of the masks{doubt}")
    spare = len({id(p) for p in by_stem.values()}) - len(set(found.values()))
    if spare > 0:
        warnings.append(f"{where}: {spare} masks belong to no image and are ignored: check their names")
    return found, warnings


def check_masks(masks: Mapping[str, Path], size_of: Callable[[str], tuple[int, int]]) -> None:
    """Raise UserError for a mask of another size than its image (sizes in pixels, from headers)."""
    for view, mask in masks.items():
        have, want = image_size(mask), size_of(view)
        if have != want:
            turned = " (turned by 90°: images are read as stored, without EXIF rotation)" if have == want[::-1] else ""
            raise UserError(
                mask, f"is {have[0]}x{have[1]}, its image is {want[0]}x{want[1]}{turned}", "make the mask in the image's size"
            )


def _refuse_unread(places: list[Path]) -> list[str]:
    """A line where a folder for masks is empty. Raises UserError where it holds files and none is of a kind that is read."""
    for place in places:
        files = sorted(p for p in place.iterdir() if p.is_file() and not p.name.startswith("."))
        if files:
            fault = f"holds {count(files, 'file')} ({some(p.name for p in files)}), none of which is a mask that is read"
            raise UserError(place, fault, "write masks as 8-bit PNG, named like the views and white on the object")
    return [f"{place}: is empty, so the views are segmented: check whether its masks were copied" for place in places[:1]]


LONE = frozenset({*MASK_FOLDERS, "silhouette", "matte"})


def _lone_mask(root: Path, folder: Path) -> list[str]:
    """A line where one mask lies beside the pictures' folder, as those of light stages do: it is of no view."""
    if folder == root:
        return []
    found = next((p for p in sorted(root.iterdir()) if p.stem.lower() in LONE and p.suffix.lower() in PHOTO_SUFFIXES), None)
    if found is None:
        return []
    return [f"{found}: is of no view and not used: give masks/VIEW.png, a mask for each picture and named like it"]
