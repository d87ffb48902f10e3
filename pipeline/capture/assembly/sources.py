"""Image files to views: which are stacks, mosaics, brackets, Stokes files or plain pictures, and how each is read."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

from pipeline.capture.assembly.loaders import colour_loader, mosaic_loader, stack_loader
from pipeline.capture.config import CaptureConfig, MosaicConfig
from pipeline.capture.model import ViewSource
from pipeline.capture.mosaic.sensor_files import mosaic_colour, refuse_colour
from pipeline.capture.naming.files import RAW_SUFFIXES, count, refuse_duplicates, some
from pipeline.capture.naming.grouping import Exposure, Group, group_and_rest
from pipeline.capture.naming.pages import paged
from pipeline.capture.pixels.stokes_files import holds_stokes, stokes_exr_loader
from pipeline.capture.radiometry.found import understand
from pipeline.capture.recognition.mosaic_set import STRAYS, mosaic_set
from pipeline.capture.recognition.stray_files import left_out_line
from pipeline.errors import UserError
from pipeline.formats.image_parts import Page
from pipeline.formats.images import channel_names, image_size

LOSSY = frozenset({".jpg", ".jpeg"})
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
    groups, unnamed = _paged_groups(paths, folder, config, is_named)
    rest: list[Path] = []
    if not groups:
        wanted = kind in (None, "stack") and not _any_stokes(paths)
        groups, rest = group_and_rest(paths, folder, config, stacks=wanted)
        if is_named is not None and any(is_named(g) for g in groups):
            unnamed = [g.paths[0] for g in groups if not is_named(g)]
            groups = [g for g in groups if is_named(g)]
    warnings = [left_out_line(rest, "part of no angle stack")] if rest else []
    found = _understood(groups, folder, config, camera_of, kind)
    return replace(found, unnamed=tuple(unnamed), warnings=(*warnings, *found.warnings))


def _paged_groups(
    paths: list[Path], folder: Path, config: CaptureConfig, is_named: Callable[[Group], bool] | None
) -> tuple[list[Group], list[Path]]:
    """A group a file where files are angle stacks by themselves (else none), and the files that a camera table leaves out."""
    names = {p: p.relative_to(folder).with_suffix("").as_posix().replace("/", "_") for p in paths}
    named = [p for p in paths if is_named is None or is_named(Group(names[p], {None: (Exposure(p),)}))] or paths
    inner = paged(named, config)
    groups = [Group(names[p], {a: (Exposure(p, page=page),) for a, page in pages.items()}) for p, pages in inner.items()]
    return groups, [p for p in paths if p not in inner] if inner else []


def _any_stokes(paths: list[Path]) -> bool:
    return any(p.suffix.lower() == ".exr" and holds_stokes(channel_names(p, plain=True)) for p in paths)


def _understood(groups: list[Group], folder: Path, config: CaptureConfig, camera_of: Camera_of, kind: str | None) -> Sources:
    if any(e.page for g in groups for es in g.angles.values() for e in es):
        _refuse_clashes(groups, folder)
        return _stacks(groups, config, camera_of)
    paths = [p for g in groups for p in g.paths]
    stokes = [p for p in paths if p.suffix.lower() == ".exr" and holds_stokes(channel_names(p, plain=True))]
    if stokes:
        odd = sorted(set(paths) - set(stokes))
        if odd:
            raise UserError(odd[0], f"holds no Stokes channels while {len(stokes)} other images do", "export every image alike")
        known = understand(groups, config, "colour")
        loaders = [stokes_exr_loader(g.paths[0], known.config, g.view) for g in groups]
        views = tuple(
            ViewSource(g.view, g.paths, camera_of(g), loader, image_size(g.paths[0])) for g, loader in zip(groups, loaders)
        )
        refuse_duplicates((g.view, p) for g in groups for p in g.paths)
        return Sources("stokes_files", views, tuple(groups), known.facts, warnings=known.warnings)
    _refuse_clashes(groups, folder)
    if any(g.is_stack for g in groups):
        return _stacks(groups, config, camera_of)
    chosen = mosaic_set([g.paths[0] for g in groups], config) if kind in (None, "mosaic") else None
    if chosen is not None:
        kept = [g for g in groups if g.paths[0] in set(chosen.mosaics)]
        refuse_colour([p for g in kept for p in g.paths], config)
        left_out = (left_out_line(chosen.others, STRAYS),) if chosen.others else ()
        mosaics = _mosaics(kept, config, camera_of)
        return replace(mosaics, warnings=(*left_out, *mosaics.warnings))
    if kind == "mosaic":
        refuse_colour([p for g in groups for p in g.paths], config)
        return _mosaics(groups, config, camera_of)
    if config.mosaic != MosaicConfig():
        refuse_colour([p for g in groups for p in g.paths], config)
    known = understand(groups, config, "colour")
    views = tuple(
        ViewSource(g.view, g.paths, camera_of(g), colour_loader(g, known.config), size_of(g.paths[0])) for g in groups
    )
    return Sources("colour", views, tuple(groups), known.facts, warnings=known.warnings)


def size_of(path: Path, page: Page | None = None) -> tuple[int, int]:
    """(width, height) as decoded; of a raw file the visible area."""
    if path.suffix.lower() in RAW_SUFFIXES:
        from pipeline.capture.pixels.raw import raw_size

        return raw_size(path)
    return image_size(path, page)


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
    known = understand(groups, config, "stack")

    def source(g: Group) -> ViewSource:
        page = next(iter(g.angles.values()))[0].page
        loader = stack_loader(g, known.config, camera_of(g))
        return ViewSource(g.view, g.paths, camera_of(g), loader, size_of(g.paths[0], page), paged=page is not None)

    inside = " (images of one file)" if any(e.page for es in usual.angles.values() for e in es) else ""
    facts = (f"stacks behind a polariser at {angles} degrees{inside}", *known.facts)
    short = [g for g in groups if len(g.angles) < len(usual.angles)]
    warnings = list(known.warnings)
    if short:
        fewer = f"{count(short, 'view')} with fewer angles than the others ({some(g.view for g in short)}; others: {angles})"
        more = "noise is larger there and wrong angles go unnoticed; check whether files are missing"
        warnings.insert(0, f"{short[0].paths[0]}: {fewer}: {more}")
    return Sources("stack", tuple(map(source, groups)), tuple(groups), facts, warnings=tuple(warnings))


def _mosaics(groups: list[Group], config: CaptureConfig, camera_of: Camera_of) -> Sources:
    colour = config.mosaic.colour or mosaic_colour([g.paths[0] for g in groups], config)
    known = understand(groups, config, "mosaic", colour == "bayer")
    views = tuple(
        ViewSource(g.view, g.paths, camera_of(g), mosaic_loader(g, known.config, colour), size_of(g.paths[0])) for g in groups
    )
    order = " ".join(f"{a:g}" for a in config.mosaic.order[:2]) + " / " + " ".join(f"{a:g}" for a in config.mosaic.order[2:])
    lossy = [p for g in groups for p in g.paths if p.suffix.lower() in LOSSY]
    spoilt = "JPEG mixes neighbours, which in a mosaic stand behind other polarisers: save the sensor's files as PNG or TIFF"
    warnings = (*known.warnings, *([f"{lossy[0]}: {spoilt}"] if lossy else []))
    what = f"polariser mosaic {order} ({'quad-Bayer ' + config.mosaic.bayer if colour == 'bayer' else 'monochrome'})"
    return Sources("mosaic", views, tuple(groups), (what, *known.facts), warnings=warnings)
