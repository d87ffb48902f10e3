"""Plain photographs (or camera raw): colour only, unless capture.toml names polarisers; COLMAP model if there is one."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from pipeline.capture.assembly.assemble import Pictures, assemble, folder_camera
from pipeline.capture.assembly.camera_source import camera_table
from pipeline.capture.assembly.sources import Sources, discover
from pipeline.capture.camera_files.table import stem_parts
from pipeline.capture.camera_files.unnamed import cameras_under_other_names
from pipeline.capture.config import CaptureConfig
from pipeline.capture.layouts import Layout
from pipeline.capture.model import Capture, Polarisation
from pipeline.capture.naming.beside_images import is_beside, outside_images
from pipeline.capture.naming.files import (
    IMAGE_FOLDERS,
    IMAGE_SUFFIXES,
    RAW_SUFFIXES,
    UNREADABLE,
    count,
    has_images,
    image_folder,
    list_images,
    some,
)
from pipeline.capture.naming.grouping import Group
from pipeline.capture.recognition.foreign import refuse_without_pictures
from pipeline.capture.recognition.one_framing import changes_light
from pipeline.capture.recognition.repeated_framing import repeated_framing_words
from pipeline.capture.recognition.stray_files import folder_of_products, refuse_products, sort_out
from pipeline.errors import UserError
from pipeline.formats.bare_arrays import ARRAY_SUFFIXES


def recognise(root: Path) -> bool:
    return any(has_images(p) for p in root.iterdir() if p.is_dir() and not outside_images(p)) or bool(loose_images(root))


def loose_images(root: Path) -> list[Path]:
    """Image files, arrays and bare samples that lie in the capture's folder itself."""
    wanted = set(IMAGE_SUFFIXES) | set(UNREADABLE) | ARRAY_SUFFIXES
    return sorted(
        p for p in root.iterdir() if p.suffix.lower() in wanted and not p.name.startswith((".", "clean_plate")) and p.is_file()
    )


def pictures(root: Path, config: CaptureConfig) -> Pictures:
    """The image folder, its files that may be views, and the cameras beside them.

    Raises UserError where every file is of a kind that nobody can read, or a camera file is damaged.
    """
    folder = image_folder(root)
    found = list_images(folder)
    if folder == root:
        plate = root / config.clean_plate if config.clean_plate else None
        found = [p for p in found if not is_beside(p, root) and p != plate and plate not in p.parents]
    if not found:
        refuse_without_pictures(root)
        raise UserError(folder, "holds no image", "copy the photographs into it")
    table, warned = camera_table(root, folder)
    stems = {stem_parts(name)[-1] for name in table.names if stem_parts(name)} if table is not None and table.names else set()
    chosen = sort_out(found, folder, stems)
    refuse_products(chosen.kept, folder)
    beside = _raw_twins(root, folder, chosen.kept) or _other_folders(root, folder)
    return Pictures(folder, chosen.kept, table, (*chosen.warnings(), *warned, *beside), cameras_told=bool(warned))


def _other_folders(root: Path, folder: Path) -> list[str]:
    """A line where another folder of pictures, by a name that image folders have, lies beside the one that is used."""
    idle = [root / name for name in IMAGE_FOLDERS if root / name != folder and has_images(root / name)]
    if not idle or folder not in [root / name for name in IMAGE_FOLDERS]:
        return []
    there = count(list_images(idle[0]), "picture")
    return [f"{idle[0]}: its {there} are not used, those in {folder.name}/ are: move them there if they are views, or away"]


def _raw_twins(root: Path, folder: Path, kept: list[Path]) -> list[str]:
    """A line where the camera's raw files lie in another folder than the pictures that are used."""
    other = root / "raw"
    if other == folder or not other.is_dir() or any(p.suffix.lower() in RAW_SUFFIXES for p in kept):
        return []
    stems = {p.stem.lower() for p in list_images(other, RAW_SUFFIXES)} & {p.stem.lower() for p in kept}
    if not stems:
        return []
    warned = f"{other}: {count(stems, 'camera raw file')} of the pictures in {folder.name}/ are not used"
    return [f"{warned}; for linear light move them into {folder.name}/ (their JPEGs are then left out)"]


def read(root: Path, config: CaptureConfig) -> Capture:
    """Open a folder of photographs."""
    return read_as(root, config, "photographs", "colour")


def read_as(root: Path, config: CaptureConfig, layout: str, kind: str) -> Capture:
    """Open a folder of images understood as one `kind` ("colour", "stack" or "mosaic"), with the cameras beside them."""
    found = pictures(root, config)
    table, folder = found.table, found.folder

    def camera_of(group: Group) -> str:
        return folder_camera(group.paths, folder, config) if kind == "colour" else "camera"

    named = None if table is None else (lambda group: table.named(group, folder))
    sources = discover(found.paths, folder, config, camera_of, kind, named)
    if table is None and config.layout is None and not config.polarisers:
        _refuse_one_framing(sources, folder)
    polarisation: Polarisation
    polarisation = "stokes" if sources.holds_stokes else "polarisers" if config.polarisers else "none"
    capture = assemble(root, layout, config, folder, sources.views, polarisation, facts=sources.facts, table=table, look=False)
    warnings = [*found.warnings, *sources.warnings, *capture.warnings]
    if table is None and not found.cameras_told:
        warnings += cameras_under_other_names(root, folder)
    if sources.kind == "colour":
        warnings += repeated_framing_words(found.paths, folder)
    if folder == root and all(folder_of_products(p, root) for p in found.paths):
        where, doubt = found.paths[0].parent, "its name says that it holds no photographs, and there are no others"
        warnings.append(f"{where}: {doubt}; check that these are the views")
    if sources.unnamed and table is not None:
        names = f"{count(sources.unnamed, 'view')} ({some(p.name for p in sources.unnamed)})"
        warnings.append(f"{table.path}: no camera for {names}; left out: check the names in both")
    return replace(capture, warnings=tuple(warnings))


def _refuse_one_framing(sources: Sources, folder: Path) -> None:
    """Pictures of one framing under changing light are no views: cameras would be looked for in vain."""
    pictures_ = [group.paths[0] for group in sources.groups]
    if changes_light(pictures_):
        fault = f"its {len(pictures_)} pictures show one framing under changing light: lights of a light stage, no views"
        remedy = (
            "a light stage needs camNN/cross and camNN/parallel frames, cameras/cameraNN.txt and a light table "
            '(docs/light_stage.md); if they are views, say layout = "photographs" in capture.toml'
        )
        raise UserError(folder, fault, remedy)


LAYOUT = Layout("photographs", "images/ with photographs or camera raw files, a COLMAP model if there is one", recognise, read)
