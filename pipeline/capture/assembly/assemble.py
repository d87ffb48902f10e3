"""From views to a Capture: cameras, masks, polarisers and environments that lie beside them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from pipeline.capture.assembly.camera_source import camera_table
from pipeline.capture.camera_files.table import CameraTable, cameras_of_views
from pipeline.capture.config import CaptureConfig
from pipeline.capture.model import Capture, Polarisation, ViewSource
from pipeline.capture.naming.beside_images import PLATES
from pipeline.capture.naming.files import (
    PHOTO_SUFFIXES,
    find_environments,
    list_images,
    polariser_priors,
    sorted_views,
)
from pipeline.capture.naming.masks import check_masks, find_masks
from pipeline.formats.images import channel_names, read_stored
from pipeline.geometry.cameras import Camera

MAY_HOLD_ALPHA = frozenset({".png", ".tif", ".tiff", ".exr"})


@dataclass(frozen=True)
class Pictures:
    """The image folder, the files in it that may be views, their cameras where a file tells them, and what to say;
    `cameras_told`: of camera files that are not read too."""

    folder: Path
    paths: list[Path]
    table: CameraTable | None
    warnings: tuple[str, ...]
    cameras_told: bool = False


def assemble(
    root: Path,
    layout: str,
    config: CaptureConfig,
    folder: Path,
    views: tuple[ViewSource, ...],
    polarisation: Polarisation,
    cameras: Mapping[str, Camera] | None = None,
    camera_files: tuple[Path, ...] = (),
    facts: tuple[str, ...] = (),
    table: CameraTable | None = None,
    look: bool = True,
    warned: tuple[str, ...] = (),
) -> Capture:
    """The Capture of `views`; without given `cameras` those of a `table`, which is looked for unless `look` is False.

    `warned`: words on what was found in the views' files. Raises UserError.
    """
    warnings = list(warned)
    if cameras is None:
        if table is None and look:
            table, warned_of_table = camera_table(root, folder)
            warnings += warned_of_table
        if table is not None:
            cameras, more = cameras_of_views(table, views, folder)
            warnings += more
            camera_files, facts = table.files, (*facts, f"cameras: {table.title}, {table.path.name}", *table.facts)
    if cameras is not None:
        views = tuple(v for v in views if v.view in cameras)
    views = sorted_views(views)
    sizes = {v.view: v.size for v in views}
    masks, more = find_masks(root, {v.view: v.paths[0] for v in views}, folder)
    check_masks(masks, lambda view: sizes[view] or (0, 0))
    plates, plate_files = find_plates(root, config, views)
    environments = find_environments(root)
    alpha, words = (False, []) if masks else alpha_of(views)
    return Capture(
        root, layout, "multiview", polarisation, views, environments=environments, config=config, up=config.up or "y",
        cameras=dict(cameras) if cameras is not None else None, masks=masks or ("alpha" if alpha else None),
        colmap=table.model if table is not None else None,
        files=(*camera_files, *(p for v in views for p in v.paths), *masks.values(), *plate_files, *environments),
        polarisers=polariser_priors([v.camera for v in views], config) if polarisation == "polarisers" else {},
        warnings=tuple(warnings + more + words), facts=facts, clean_plates=plates,
    )  # fmt: skip


def alpha_of(views: Sequence[ViewSource]) -> tuple[bool, list[str]]:
    """Whether every view's image carries an alpha channel (headers only); and a line where some images cut the object out in
    theirs and others have none: then nothing is taken from it."""
    files = [v.paths[0] for v in views if not v.paged and v.paths[0].suffix.lower() in MAY_HOLD_ALPHA]
    there = [p for p in files if "A" in channel_names(p, plain=True)]
    if len(there) == len(views):
        return bool(views), []
    cut = next((p for p in there if _cuts_out(p)), None)
    if cut is None:
        return False, []
    have = f"{len(there)} of {len(views)} images have an alpha (such as {cut.name}), the others none"
    return False, [f"{cut.parent}: {have}: it is not used as masks; cut all of them out, or give masks/ named like the views"]


def _cuts_out(path: Path) -> bool:
    """Whether an image's alpha is not the same all over."""
    pixels, names, _ = read_stored(path)
    alpha = pixels[..., names.index("A")] if "A" in names else pixels[:0]
    return bool(alpha.size and alpha.min() < alpha.max())


def find_plates(root: Path, config: CaptureConfig, views: tuple[ViewSource, ...]) -> tuple[dict[str, Path], tuple[Path, ...]]:
    """Photographs of the empty scene, by VIEW: one of the view's name, its camera's name, or one for all."""
    place = root / config.clean_plate if config.clean_plate else next((root / n for n in PLATES if (root / n).is_dir()), None)
    if place is None:
        singles = [
            p for n in PLATES for p in sorted(root.glob(f"{n}.*")) if p.suffix.lower() in PHOTO_SUFFIXES | {".exr", ".hdr"}
        ]
        place = singles[0] if singles else None
    if place is None:
        return {}, ()
    files = list_images(place) if place.is_dir() else [place]
    by_stem = {p.stem: p for p in files}
    plates = {}
    for view in views:
        plate = by_stem.get(view.view) or by_stem.get(view.camera) or (files[0] if len(files) == 1 else None)
        if plate is not None:
            plates[view.view] = plate
    return plates, tuple(sorted(set(plates.values())))


def folder_camera(paths: tuple[Path, ...], folder: Path, config: CaptureConfig) -> str:
    """The physical camera that a folder names: one of capture.toml's, else "camera"."""
    parts = paths[0].relative_to(folder).parts[:-1]
    named = [p for p in parts if p in config.polarisers]
    return named[0] if named else "camera"
