"""Finding a capture's files: images, views, masks, environment maps; all by name and header, no pixels."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from pathlib import Path

from pipeline.capture.config import CaptureConfig
from pipeline.capture.model import PolariserPrior, ViewSource
from pipeline.errors import UserError
from pipeline.formats.bare_arrays import ARRAY_SUFFIXES

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
ARCHIVES = frozenset({".zip", ".7z", ".rar", ".tar", ".gz", ".tgz", ".xz", ".bz2", ".zst"})
DUMPS = frozenset({".bin", ".dat", ".mat", ".bayer", ".yuv", ".fit", ".fits"})
"""Samples without a header that says what they are, or arrays: pictures where they lie in an image folder."""
MASK_FOLDERS = ("masks", "mask")
OLAT = "olat"
"""Folder, lower case, of a light stage beside the views of the same object."""
ASIDE = frozenset({*MASK_FOLDERS, "gt", "envmaps", OLAT})
"""Folders, lower case, of what lies beside a capture's images."""
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
