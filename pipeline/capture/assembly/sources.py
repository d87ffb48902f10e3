"""Image files to views: which are stacks, mosaics, brackets, Stokes files or plain pictures, and how each is read."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pipeline.capture.angle_stack.solve import design_covariance, polariser_design
from pipeline.capture.config import CaptureConfig
from pipeline.capture.model import DecodedView, ViewSource
from pipeline.capture.mosaic.order import order_fault
from pipeline.capture.mosaic.sensor_files import mosaic_colour, read_mosaic
from pipeline.capture.naming.files import RAW_SUFFIXES, refuse_duplicates
from pipeline.capture.naming.grouping import Group, group_and_rest
from pipeline.capture.pixels.brackets import read_exposures
from pipeline.capture.pixels.stokes_files import finished, holds_stokes, is_verbatim, mended, stokes_exr_loader
from pipeline.capture.pixels.stokes_frame import apply_stokes_config
from pipeline.capture.recognition.mosaic_set import STRAYS, mosaic_set
from pipeline.capture.recognition.strangers import left_out_line
from pipeline.errors import UserError
from pipeline.formats.images import channel_names, image_size

NO_CARRIERS = "mosaic.order has no crossed polarisers on the diagonals: each angle is interpolated on its own, less exactly"

Camera_of = Callable[[Group], str]


@dataclass(frozen=True)
class Sources:
    """The views of a set of files; `kind` is "stokes_files", "stack", "mosaic" or "colour"; facts for the user.

    unnamed: files of views that the camera table does not name; warnings: files that are no views, and why.
    """

    kind: str
    views: tuple[ViewSource, ...]
    groups: tuple[Group, ...]
    facts: tuple[str, ...] = ()
    unnamed: tuple[Path, ...] = ()
    warnings: tuple[str, ...] = ()

    @property
    def holds_stokes(self) -> bool:
        return self.kind != "colour"


def discover(
    paths: list[Path],
    folder: Path,
    config: CaptureConfig,
    camera_of: Camera_of,
    kind: str | None = None,
    is_named: Callable[[Group], bool] | None = None,
) -> Sources:
    """Views of the image files `paths` below `folder`. Raises UserError on names that clash or files that cannot mix.

    `kind` forces the understanding ("mosaic", "stack", "colour") where a layout or capture.toml says so. `is_named` tells
    whether a camera table names a view: the others are left out before pixels are looked at.
    """
    wanted = kind in (None, "stack") and not _any_stokes(paths)
    groups, rest = group_and_rest(paths, folder, config, stacks=wanted)
    warnings = [left_out_line(rest, "part of no angle stack")] if rest else []
    unnamed: tuple[Path, ...] = ()
    if is_named is not None and any(is_named(g) for g in groups):
        unnamed = tuple(g.paths[0] for g in groups if not is_named(g))
        groups = [g for g in groups if is_named(g)]
    found = _understood(groups, folder, config, camera_of, kind)
    return replace(found, unnamed=unnamed, warnings=(*warnings, *found.warnings))


def _any_stokes(paths: list[Path]) -> bool:
    return any(p.suffix.lower() == ".exr" and holds_stokes(channel_names(p)) for p in paths)


def _understood(groups: list[Group], folder: Path, config: CaptureConfig, camera_of: Camera_of, kind: str | None) -> Sources:
    paths = [p for g in groups for p in g.paths]
    stokes = [p for p in paths if p.suffix.lower() == ".exr" and holds_stokes(channel_names(p))]
    if stokes:
        odd = sorted(set(paths) - set(stokes))
        if odd:
            raise UserError(odd[0], f"holds no Stokes channels while {len(stokes)} other images do", "export every image alike")
        views = tuple(
            ViewSource(g.view, g.paths, camera_of(g), stokes_exr_loader(g.paths[0], config), image_size(g.paths[0]))
            for g in groups
        )
        refuse_duplicates((g.view, p) for g in groups for p in g.paths)
        return Sources("stokes_files", views, tuple(groups))
    _refuse_clashes(groups, folder)
    if any(g.is_stack for g in groups):
        return _stacks(groups, config, camera_of)
    chosen = mosaic_set([g.paths[0] for g in groups], config) if kind in (None, "mosaic") else None
    if chosen is not None:
        kept = [g for g in groups if g.paths[0] in set(chosen.mosaics)]
        told = (left_out_line(chosen.others, STRAYS),) if chosen.others else ()
        return replace(_mosaics(kept, config, camera_of), warnings=told)
    if kind == "mosaic":
        return _mosaics(groups, config, camera_of)
    views = tuple(ViewSource(g.view, g.paths, camera_of(g), _colour_loader(g, config), size_of(g.paths[0])) for g in groups)
    return Sources("colour", views, tuple(groups))


def size_of(path: Path) -> tuple[int, int]:
    """(width, height) as decoded; of a raw file the visible area."""
    if path.suffix.lower() in RAW_SUFFIXES:
        from pipeline.capture.pixels.raw import raw_size

        return raw_size(path)
    return image_size(path)


def _refuse_clashes(groups: list[Group], folder: Path) -> None:
    """Two files for one view and angle that are no bracket: 001.png beside 001.exr, a_b.png beside a/b.png."""
    seen: dict[str, Path] = {}
    for group in groups:
        if group.view in seen:
            raise UserError(
                group.paths[0], f"has the same view name {group.view!r} as {seen[group.view]}", "rename or remove one"
            )
        seen[group.view] = group.paths[0]
        for exposures in group.angles.values():
            plain = [e for e in exposures if e.seconds is None and e.stops is None]
            if len(plain) > 1:
                first, second = sorted(e.path for e in plain)[:2]
                raise UserError(second, f"has the same view name {group.view!r} as {first}", "rename or remove one of them")


def _stacks(groups: list[Group], config: CaptureConfig, camera_of: Camera_of) -> Sources:
    usual = max(groups, key=lambda g: len(g.angles))
    for g in groups:
        if len(g.angles) < 3:
            have = ", ".join(f"{a:g}°" for a in g.angles if a is not None)
            want = ", ".join(f"{a:g}°" for a in usual.angles if a is not None)
            raise UserError(
                g.paths[0],
                f"view {g.view} has only the angles {have} (others have {want})",
                "add the missing files, or remove the view",
            )
    angles = ", ".join(f"{a:g}" for a in usual.angles if a is not None)
    views = tuple(
        ViewSource(g.view, g.paths, camera_of(g), _stack_loader(g, config, camera_of(g)), size_of(g.paths[0])) for g in groups
    )
    return Sources("stack", views, tuple(groups), (f"stacks behind a polariser at {angles} degrees",))


def _mosaics(groups: list[Group], config: CaptureConfig, camera_of: Camera_of) -> Sources:
    colour = config.mosaic.colour or mosaic_colour([g.paths[0] for g in groups], config)
    views = tuple(
        ViewSource(g.view, g.paths, camera_of(g), _mosaic_loader(g, config, colour), size_of(g.paths[0])) for g in groups
    )
    order = " ".join(f"{a:g}" for a in config.mosaic.order[:2]) + " / " + " ".join(f"{a:g}" for a in config.mosaic.order[2:])
    return Sources(
        "mosaic",
        views,
        tuple(groups),
        (f"polariser mosaic {order} ({'quad-Bayer ' + config.mosaic.bayer if colour == 'bayer' else 'monochrome'})",),
    )


def _colour_loader(group: Group, config: CaptureConfig) -> Callable[[], DecodedView]:
    def load() -> DecodedView:
        image = read_exposures(group.angles[None], config.radiometry)
        rgb = np.ascontiguousarray(image.rgb(group.paths[0]))
        if config.radiometry.white_balance:
            rgb *= np.asarray(config.radiometry.white_balance, np.float32)
        view = finished(DecodedView(rgb=rgb, saturated=image.saturated, alpha=image.alpha), group.paths[0], image)
        if len(group.paths) == 1 and is_verbatim(view, image, group.paths[0], ("R", "G", "B"), config):
            view.verbatim = group.paths[0]
        return view

    return load


def _stack_loader(group: Group, config: CaptureConfig, camera: str) -> Callable[[], DecodedView]:
    def load() -> DecodedView:
        from pipeline.capture.angle_stack.reader import read_stack

        return read_stack(group, config, config.polarisers.get(camera))

    return load


def _mosaic_loader(group: Group, config: CaptureConfig, colour: str) -> Callable[[], DecodedView]:
    def load() -> DecodedView:
        from pipeline.capture.mosaic.carriers import carries
        from pipeline.capture.mosaic.demosaic import demosaic

        path = group.paths[0]
        image = read_mosaic(group, config)
        image.saturated, faults = mended(image.pixels, image.saturated, path)  # a hole would spread over its windows
        samples = image.pixels[..., 0]
        block = 4 if colour == "bayer" else 2
        if samples.shape[0] % block or samples.shape[1] % block:
            raise UserError(
                path,
                f"{samples.shape[1]}x{samples.shape[0]} are no whole {block}x{block} polariser blocks",
                "crop to whole blocks, or is it no mosaic?",
            )
        told = config.polarisers.get(group_camera(group))
        extinction = told.extinction if told else None
        stokes = demosaic(samples, config.mosaic.order, colour, config.mosaic.bayer, config.mosaic.demosaic, extinction)
        if config.radiometry.white_balance:
            stokes *= np.asarray(config.radiometry.white_balance, np.float32)
        stokes = apply_stokes_config(stokes, config.stokes)
        design = polariser_design(config.mosaic.order, extinction)
        view = DecodedView(
            stokes=stokes, saturated=_block_any(image.saturated), design=design, covariance=design_covariance(design)
        )
        fault = order_fault(samples, config.mosaic.order)
        if not fault and config.mosaic.demosaic == "carriers" and not carries(config.mosaic.order):
            fault = NO_CARRIERS
        if fault:
            view.faults[fault] = 0
        view.faults |= faults
        return finished(view, path, image, whole=True)

    return load


def group_camera(group: Group) -> str:
    """A mosaic's one physical camera."""
    return "camera"


def _block_any(saturated: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """A saturated sample spoils every pixel that uses it: its neighbours within two pixels."""
    from scipy.ndimage import binary_dilation

    return binary_dilation(saturated, iterations=2, structure=np.ones((3, 3), bool)) if saturated.any() else saturated
