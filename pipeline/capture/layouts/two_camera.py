"""PhyGaP's two-camera captures: one COLMAP folder per polariser, each with its images and model, in one world frame."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from itertools import combinations
from pathlib import Path

from pipeline.capture.assembly.camera_source import from_colmap
from pipeline.capture.assembly.sources import discover
from pipeline.capture.config import CaptureConfig
from pipeline.capture.layouts import Layout
from pipeline.capture.model import Capture, ViewSource
from pipeline.capture.naming.files import (
    find_environments,
    image_folder,
    list_images,
    polariser_priors,
    sorted_views,
)
from pipeline.capture.naming.grouping import group_and_rest
from pipeline.capture.naming.masks import check_masks, find_masks
from pipeline.capture.radiometry.across_folders import even_out_across
from pipeline.capture.recognition.stray_files import Sorted, sort_out
from pipeline.errors import UserError
from pipeline.formats.colmap import find_model
from pipeline.geometry.cameras import Camera
from pipeline.geometry.separate_worlds import ONE_WORLD, two_worlds


def recognise(root: Path) -> bool:
    return find_model(root) is None and len(camera_folders(root)) >= 2


def camera_folders(root: Path) -> list[Path]:
    """Folders with a COLMAP model of their own."""
    return [p for p in sorted(root.iterdir()) if p.is_dir() and not p.name.startswith(".") and find_model(p) is not None]


def read(root: Path, config: CaptureConfig) -> Capture:
    """Open the capture; views are named FOLDER_IMAGE, the folder names the polariser."""
    views: list[ViewSource] = []
    cameras: dict[str, Camera] = {}
    masks: dict[str, Path] = {}
    files: list[Path] = []
    warnings: list[str] = []
    facts: list[str] = []
    pictures = {folder: _pictures(folder) for folder in camera_folders(root)}
    for chosen in pictures.values():
        warnings += chosen.warnings()
    config, exposures, doubts = _evened_out(pictures, config)
    facts += exposures
    warnings += doubts
    for folder, chosen in pictures.items():
        images, paths = image_folder(folder), chosen.kept
        name = folder.name
        own = _of_folder(config, name)
        here = discover(paths, images, own, lambda _, name=name: name, kind="colour")  # type: ignore[misc]
        facts += [f"{name}: {fact}" for fact in here.facts]
        found, _, more, model = from_colmap(folder, here.views, images)
        kept = [v for v in here.views if v.view in found]
        given, missing = find_masks(folder, {v.view: v.paths[0] for v in kept}, images)
        check_masks(given, lambda view, kept=kept: next(v.size or (0, 0) for v in kept if v.view == view))  # type: ignore[misc]
        views += [replace(v, view=f"{name}_{v.view}") for v in kept]
        cameras.update({f"{name}_{view}": camera for view, camera in found.items()})
        masks.update({f"{name}_{view}": path for view, path in given.items()})
        warnings += [*here.warnings, *more, *missing]
        files += [*model, *(p for v in kept for p in v.paths), *given.values()]
    _refuse_two_worlds(root, views, cameras)
    environments = find_environments(root)
    return Capture(
        root, "phygap_two_camera", "multiview", "polarisers", sorted_views(views), environments=environments, config=config,
        up=config.up or "y", cameras=cameras, masks=masks or None, files=(*files, *environments), warnings=tuple(warnings),
        polarisers=polariser_priors({v.camera for v in views}, config), facts=tuple(facts),
    )  # fmt: skip


def _pictures(folder: Path) -> Sorted:
    """The pictures of one camera, and what was left out. Raises UserError where there are none."""
    images = image_folder(folder)
    paths = list_images(images) if images != folder else [p for p in list_images(folder) if "mask" not in p.parent.name]
    chosen = sort_out(paths, images)
    if not chosen.kept:
        raise UserError(images, "the COLMAP folder holds no image", "put the images behind this polariser into images/")
    return chosen


def _evened_out(
    pictures: Mapping[Path, Sorted], config: CaptureConfig
) -> tuple[CaptureConfig, tuple[str, ...], tuple[str, ...]]:
    """The settings by which the pictures of all cameras have one exposure, with facts and warnings."""
    own = [
        group
        for folder, chosen in pictures.items()
        for group in group_and_rest(chosen.kept, image_folder(folder), _of_folder(config, folder.name), stacks=False)[0]
    ]
    found = even_out_across(own, config)
    return found.config, found.facts, found.warnings


def _of_folder(config: CaptureConfig, name: str) -> CaptureConfig:
    """The settings as one folder's files know them: exposures known by VIEW, which begins with the folder's name here."""
    known = config.radiometry.exposure_s
    of_views = {key.removeprefix(f"{name}_"): seconds for key, seconds in known.items() if key.startswith(f"{name}_")}
    return replace(config, radiometry=replace(config.radiometry, exposure_s={**known, **of_views}))


def _refuse_two_worlds(root: Path, views: list[ViewSource], cameras: dict[str, Camera]) -> None:
    """Raise UserError where two folders' models have worlds of their own."""
    by_folder: dict[str, dict[str, Camera]] = {}
    for view in views:
        by_folder.setdefault(view.camera, {})[view.view.removeprefix(f"{view.camera}_")] = cameras[view.view]
    for first, second in combinations(sorted(by_folder), 2):
        fault = two_worlds(by_folder[first], by_folder[second])
        if fault:
            raise UserError(root, f"the cameras of {first} and {second} {fault}", ONE_WORLD)


LAYOUT = Layout("two_camera", "two folders, one per polariser, each with a COLMAP model and its images", recognise, read)
