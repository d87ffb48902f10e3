"""Finding a capture's files: images, views, masks, environment maps; all by name and header, no pixels."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path

from pipeline.capture.config import CaptureConfig
from pipeline.capture.model import PolariserPrior, ViewSource
from pipeline.errors import UserError
from pipeline.formats.bare_arrays import ARRAY_SUFFIXES
from pipeline.formats.images import channel_names, image_size, read_image

FLOAT_SUFFIXES = frozenset({".exr", ".hdr"})
PHOTO_SUFFIXES = frozenset({".png", ".tif", ".tiff", ".jpg", ".jpeg", ".bmp", ".tga", ".pgm", ".ppm", ".pnm", ".pfm", ".webp"})
RAW_SUFFIXES = frozenset(
    {".dng", ".nef", ".cr2", ".cr3", ".arw", ".raf", ".orf", ".rw2", ".pef", ".srw", ".3fr", ".iiq", ".nrw", ".kdc", ".dcr",
     ".crw", ".mrw", ".mef", ".mos", ".erf", ".rwl", ".sr2", ".srf", ".fff", ".x3f", ".gpr"}
)  # fmt: skip
IMAGE_SUFFIXES = FLOAT_SUFFIXES | PHOTO_SUFFIXES | RAW_SUFFIXES
VIDEO = "a video is compressed and tone-mapped; export its frames as images"
TONE_MAPPED = "is tone-mapped or compressed for the eye; export 16-bit TIFF or shoot DNG"
REWRITE = "is not read; write the same pixels as PNG or TIFF (lossless)"
UNREADABLE = {
    ".r3d": "RED R3D files need RED's own decoder; export them as linear EXR (REDCINE-X, DaVinci Resolve)",
    ".braw": "Blackmagic RAW needs its own decoder; export it as linear EXR (DaVinci Resolve)",
    ".heic": "HEIC photographs are tone-mapped; export 16-bit TIFF or shoot DNG",
    ".heif": "HEIF photographs are tone-mapped; export 16-bit TIFF or shoot DNG",
    ".psd": "layers of a Photoshop file are no photograph; save it flattened as 16-bit TIFF",
    ".gif": "GIF keeps 256 colours; export 16-bit TIFF or PNG",
    **dict.fromkeys((".mp4", ".mov", ".avi", ".mkv", ".webm", ".m4v", ".mts"), VIDEO),
    **{s: f"{s[1:].upper()} {TONE_MAPPED}" for s in (".avif", ".jxl")},
    **{s: f"{s[1:].upper()} {REWRITE}" for s in (".jp2", ".dpx")},
}
"""Kinds of pictures that nobody here reads, with the way out of each."""
DUMPS = frozenset({".bin", ".dat", ".mat", ".bayer", ".yuv", ".fit", ".fits"})
"""Samples without a header that says what they are, or arrays: pictures where they lie in an image folder."""
MASK_FOLDERS = ("masks", "mask")
OLAT = "olat"
"""Folder, lower case, of a light stage beside the views of the same object."""
ASIDE = frozenset({*MASK_FOLDERS, "gt", "envmaps", OLAT})
"""Folders, lower case, of what lies beside a capture's images."""
BETWEEN = 0.1
"""Share of a mask's samples that are neither black nor white, at most: soft edges."""
IMAGE_FOLDERS = ("images", "images_full", "image", "raw", "photos")
UNDISTORTED = frozenset({"dense", "undistorted"})
"""Folders in which COLMAP writes undistorted images, with the model that belongs to them."""


def list_images(folder: Path, suffixes: Iterable[str] = IMAGE_SUFFIXES) -> list[Path]:
    """Image files below `folder`, sorted by path; arrays and bare samples where there are no others. Raises UserError naming
    the way out of formats nobody can read."""
    wanted, found, foreign, bare = set(suffixes), [], [], []
    for where, folders, names in _walk(folder):
        folders[:] = sorted(f for f in folders if not f.startswith("."))
        for name in names:
            suffix = Path(name).suffix.lower()
            if name.startswith("."):
                continue
            if suffix in wanted:
                found.append(Path(where) / name)
            elif suffix in UNREADABLE:
                foreign.append(Path(where) / name)
            elif suffix in ARRAY_SUFFIXES and wanted == IMAGE_SUFFIXES:
                bare.append(Path(where) / name)
    found = found or bare
    if foreign and not found:
        raise UserError(sorted(foreign)[0], "cannot be read", UNREADABLE[sorted(foreign)[0].suffix.lower()])
    return sorted(found)


def has_images(folder: Path, suffixes: Iterable[str] = IMAGE_SUFFIXES) -> bool:
    """Whether any image lies anywhere below `folder`."""
    wanted = set(suffixes) | set(UNREADABLE)
    wanted |= ARRAY_SUFFIXES if set(suffixes) == IMAGE_SUFFIXES else frozenset()
    return folder.is_dir() and any(
        Path(name).suffix.lower() in wanted for _, _, names in _walk(folder) for name in names if not name.startswith(".")
    )


def _walk(folder: Path) -> Iterator[tuple[str, list[str], list[str]]]:
    """As os.walk. Raises UserError where the folder is a link to one above its own: all that lies there is no capture."""
    if folder.is_symlink() and folder.resolve() in folder.parent.resolve().parents:
        raise UserError(folder, "is a link to a folder that the capture lies in", "let it lead to the images' own folder")
    yield from os.walk(folder)


def image_folder(root: Path) -> Path:
    """The folder that VIEW names are relative to: images/ or one of its common other names, dense/0/images, or that of the
    only folder with pictures (an archive that was unpacked into one of its own name), else the root."""
    for name in IMAGE_FOLDERS:
        if has_images(root / name):
            return root / name
    places = [p for name in sorted(UNDISTORTED) for p in (root / name, *sorted((root / name).glob("*"))) if p.is_dir()]
    workspaces = [p for p in places if has_images(p / "images")]
    if workspaces:
        return max(workspaces, key=lambda p: len(list_images(p / "images"))) / "images"
    homes = [p for p in subfolders(root) if has_images(p)]
    inner = next((homes[0] / name for name in IMAGE_FOLDERS if has_images(homes[0] / name)), None) if len(homes) == 1 else None
    loose = any(p.suffix.lower() in IMAGE_SUFFIXES and not p.name.startswith(".") for p in root.iterdir())
    return inner if inner is not None and not loose else root


def subfolders(root: Path, aside: frozenset[str] = ASIDE) -> list[Path]:
    """Folders in `root`, sorted, that may hold a part of a capture: none that is hidden, of masks, truth or lights."""
    return [p for p in sorted(root.iterdir()) if p.is_dir() and not p.name.startswith(".") and p.name.lower() not in aside]


def refuse_duplicates(named: Iterable[tuple[str, Path]]) -> None:
    """Raise UserError where two files would become the same VIEW (001.png beside 001.exr, a_b.png beside a/b.png)."""
    seen: dict[str, Path] = {}
    for view, path in named:
        if view in seen:
            raise UserError(path, f"has the same view name {view!r} as {seen[view]}", "rename or remove one of them")
        seen[view] = path


def find_environments(root: Path) -> tuple[Path, ...]:
    """envmaps/*.hdr and *.exr, sorted."""
    folder = root / "envmaps"
    if not folder.is_dir():
        return ()
    return tuple(sorted(p for p in folder.iterdir() if p.suffix.lower() in FLOAT_SUFFIXES and not p.name.startswith(".")))


def mask_folders(root: Path) -> list[Path]:
    """Folders named as masks are, whatever their case, the usual names first."""
    found = [p for p in root.iterdir() if p.name.lower() in MASK_FOLDERS and p.is_dir()]
    return sorted(found, key=lambda p: (p.name not in MASK_FOLDERS, MASK_FOLDERS.index(p.name.lower()), p.name))


def masks_under_other_names(root: Path, views: Mapping[str, Path], folder: Path) -> list[str]:
    """A line where another folder holds a black and white picture for every view, as masks under another name are."""
    stems = {path.stem for path in views.values()}
    for place in sorted(p for p in root.iterdir() if p.is_dir() and not p.name.startswith(".")):
        if place.name.lower() in ASIDE or folder.is_relative_to(place):
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
        return {}, masks_under_other_names(root, views, folder)
    by_stem: dict[str, Path] = {}
    for path in list_images(where, PHOTO_SUFFIXES):
        name = path.relative_to(where).with_suffix("").as_posix()
        by_stem.setdefault(name, path)
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


def polariser_priors(cameras: Iterable[str], config: CaptureConfig) -> dict[str, PolariserPrior]:
    """What capture.toml states of each physical camera's polariser; nothing stated: angle unknown, to be optimised."""
    out = {}
    for name in sorted(set(cameras)):
        stated = config.polarisers.get(name)
        if stated is None:
            out[name] = PolariserPrior()
        else:
            out[name] = PolariserPrior(stated.angle_deg, stated.trusted and stated.angle_deg is not None, stated.extinction)
    return out


def sorted_views(views: Iterable[ViewSource]) -> tuple[ViewSource, ...]:
    """Views in the order that every stage uses: sorted by VIEW."""
    return tuple(sorted(views, key=lambda v: v.view))


def count(items: Iterable[object], noun: str) -> str:
    """Write a count with its noun: '1 view', '3 views'.

    Args:
        items: what is counted.
        noun: singular.

    Returns:
        The words.
    """
    n = len(list(items))
    return f"{n} {noun}" if n == 1 else f"{n} {noun}s"


def some(names: Iterable[str], limit: int = 4) -> str:
    """Write the first few of many names.

    Args:
        names: all.
        limit: how many are written out.

    Returns:
        The words: 'a, b and 3 more'.
    """
    listed = list(names)
    return ", ".join(listed[:limit]) + (f" and {len(listed) - limit} more" if len(listed) > limit else "")
