"""Image files to views: which are stacks, mosaics, brackets, Stokes files or plain pictures, and how each is read."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pipeline.capture.brackets import read_exposures
from pipeline.capture.config import CaptureConfig
from pipeline.capture.files import RAW_SUFFIXES, refuse_duplicates
from pipeline.capture.frame import apply_stokes_config
from pipeline.capture.grouping import Group, group_files
from pipeline.capture.model import DecodedView, ViewSource
from pipeline.capture.mosaic_signs import is_mosaic, mosaic_colour, read_mosaic
from pipeline.capture.stack import design_covariance, polariser_design, solve_stack
from pipeline.capture.stokes_files import finished, holds_stokes, is_verbatim, stokes_exr_loader
from pipeline.errors import UserError
from pipeline.images import channel_names, image_size

Camera_of = Callable[[Group], str]


@dataclass(frozen=True)
class Sources:
    """The views of a set of files; `kind` is "stokes_files", "stack", "mosaic" or "colour"; facts for the user."""

    kind: str
    views: tuple[ViewSource, ...]
    groups: tuple[Group, ...]
    facts: tuple[str, ...] = ()

    @property
    def holds_stokes(self) -> bool:
        return self.kind != "colour"


def discover(paths: list[Path], folder: Path, config: CaptureConfig, camera_of: Camera_of, kind: str | None = None) -> Sources:
    """Views of the image files `paths` below `folder`. Raises UserError on names that clash or files that cannot mix.

    `kind` forces the understanding ("mosaic", "stack", "colour") where a layout or capture.toml says so.
    """
    stokes = [p for p in paths if p.suffix.lower() == ".exr" and holds_stokes(channel_names(p))]
    if stokes:
        odd = sorted(set(paths) - set(stokes))
        if odd:
            raise UserError(odd[0], f"holds no Stokes channels while {len(stokes)} other images do", "export every image alike")
        groups = group_files(paths, folder, config, stacks=False)
        views = tuple(
            ViewSource(g.view, g.paths, camera_of(g), stokes_exr_loader(g.paths[0], config), image_size(g.paths[0]))
            for g in groups
        )
        refuse_duplicates((g.view, p) for g in groups for p in g.paths)
        return Sources("stokes_files", views, tuple(groups))
    groups = group_files(paths, folder, config, stacks=kind in (None, "stack"))
    _refuse_clashes(groups, folder)
    if any(g.is_stack for g in groups):
        return _stacks(groups, config, camera_of)
    if kind == "mosaic" or (kind is None and is_mosaic([g.paths[0] for g in groups], config)):
        return _mosaics(groups, config, camera_of)
    views = tuple(ViewSource(g.view, g.paths, camera_of(g), _colour_loader(g, config), size_of(g.paths[0])) for g in groups)
    return Sources("colour", views, tuple(groups))


def size_of(path: Path) -> tuple[int, int]:
    """(width, height) as decoded; of a raw file the visible area."""
    if path.suffix.lower() in RAW_SUFFIXES:
        from pipeline.capture.raw import raw_size

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
    angles = [a for a in group.angles if a is not None]
    told = config.polarisers.get(camera)
    design = polariser_design(angles, told.extinction if told else None)

    def load() -> DecodedView:
        samples = spoilt = first = None
        for k, exposures in enumerate(group.angles.values()):  # one file at a time: a frame can be large
            image = read_exposures(exposures, config.radiometry)
            rgb = image.rgb(exposures[0].path)
            if samples is None or spoilt is None or first is None:
                samples, spoilt = np.empty((len(angles), *rgb.shape), np.float32), np.zeros((len(angles), *rgb.shape[:2]), bool)
                first = image
            if rgb.shape != samples.shape[1:]:
                have, want = rgb.shape[1::-1], samples.shape[2:0:-1]
                raise UserError(exposures[0].path, f"is {have[0]}x{have[1]}, its stack {want[0]}x{want[1]}", "one size a stack")
            samples[k] = rgb
            spoilt[k] = image.saturated
        assert samples is not None and spoilt is not None and first is not None
        first.pixels = samples[0]
        holes = np.zeros(samples.shape[1:3], bool)
        if not np.isfinite(samples.sum()):
            bad: NDArray[np.bool_] = np.any(~np.isfinite(samples), axis=-1)
            samples[bad] = 0
            spoilt, holes = np.logical_or(spoilt, bad), np.any(bad, axis=0)
        stokes, lost = solve_stack(samples, design, ~spoilt if spoilt.any() else None)
        if config.radiometry.white_balance:
            stokes *= np.asarray(config.radiometry.white_balance, np.float32)
        stokes = apply_stokes_config(stokes, config.stokes)
        view = DecodedView(stokes=stokes, saturated=lost, design=design, covariance=design_covariance(design))
        if len(angles) > 3:
            view.noise = _stack_noise(samples, design)
            moved = _movement(samples, design)
            if moved:
                view.faults[
                    "the angles do not fit one Stokes vector along edges: did the camera or the object move between them?"
                ] = 0
        if holes.any():
            view.faults["not finite: left out of the fit"] = int(holes.sum())
        return finished(view, group.paths[0], first)

    return load


def _residuals(samples: NDArray[np.float32], design: NDArray[np.float64]) -> NDArray[np.float32]:
    """What no Stokes vector explains of samples [n, H, W, C], on some rows."""
    some = samples[:, :: row_step(samples)]
    projector = (np.eye(len(design)) - design @ np.linalg.pinv(design)).astype(np.float32)
    return (projector @ some.reshape(len(samples), -1)).reshape(some.shape)


def row_step(samples: NDArray[np.float32]) -> int:
    """Rows to step over so that about a hundred thousand pixels are looked at."""
    return max(4, samples.shape[1] * samples.shape[2] // 100_000)


def _stack_noise(samples: NDArray[np.float32], design: NDArray[np.float64]) -> float:
    """Standard deviation of a sample, from the residuals (n - 3 degrees of freedom)."""
    residual = _residuals(samples, design)
    return float(np.median(np.abs(residual)) / 0.6745 * np.sqrt(len(design) / (len(design) - 3)))


MOVED = 0.25
"""Of the local contrast: residuals this large at edges are a shift of a quarter of a pixel, not noise."""


def _movement(samples: NDArray[np.float32], design: NDArray[np.float64]) -> bool:
    """Whether residuals follow edges, as they do where the pictures of a stack do not lie on each other."""
    residual = np.abs(_residuals(samples, design)).max(0).mean(-1)
    grey = samples[:, :: row_step(samples)].mean((0, -1))
    gradient = np.abs(np.gradient(grey, axis=1))
    strong = gradient > np.percentile(gradient, 95)
    flat = gradient < np.percentile(gradient, 50)
    if strong.sum() < 50 or not gradient[strong].mean() > 0:
        return False
    excess = float(residual[strong].mean() - residual[flat].mean())
    return excess > MOVED * float(gradient[strong].mean())


def _mosaic_loader(group: Group, config: CaptureConfig, colour: str) -> Callable[[], DecodedView]:
    def load() -> DecodedView:
        from pipeline.capture.mosaic import demosaic

        path = group.paths[0]
        image = read_mosaic(group, config)
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
        return finished(view, path, image)

    return load


def group_camera(group: Group) -> str:
    """A mosaic's one physical camera."""
    return "camera"


def _block_any(saturated: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """A saturated sample spoils every pixel that uses it: its neighbours within two pixels."""
    from scipy.ndimage import binary_dilation

    return binary_dilation(saturated, iterations=2, structure=np.ones((3, 3), bool)) if saturated.any() else saturated
