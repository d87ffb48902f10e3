"""Loaders for files that hold Stokes vectors or plain colour already."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.capture.config import CaptureConfig, RadiometryConfig, StokesConfig
from pipeline.capture.model import DecodedView
from pipeline.capture.pixels.linear import fill_holes, read_linear
from pipeline.capture.pixels.linear_image import LinearImage, balance
from pipeline.capture.pixels.stokes_frame import apply_stokes_config
from pipeline.capture.radiometry.exposure import known_seconds
from pipeline.capture.radiometry.of_file import factor_of
from pipeline.errors import UserError
from pipeline.formats.exr_frame import primaries_remark
from pipeline.formats.images import STOKES

GREY_STOKES = (("S0.Y", "S1.Y", "S2.Y"), ("S0", "S1", "S2"))


def holds_stokes(names: list[str] | tuple[str, ...]) -> bool:
    """Whether these channel names are a Stokes image (colour or grey)."""
    lower = {name.lower() for name in names}
    return any(all(c.lower() in lower for c in wanted) for wanted in (STOKES, *GREY_STOKES))


def stokes_of(image: LinearImage, path: Path) -> NDArray[np.float32]:
    """The Stokes channels [H, W, 3 stokes, 3 rgb]; grey ones are repeated. Raises UserError naming what is missing."""
    lower = {name.lower() for name in image.names}
    for wanted in GREY_STOKES:
        if all(c.lower() in lower for c in wanted):
            return np.repeat(image.channels(wanted, path)[..., None], 3, axis=-1)
    flat = np.ascontiguousarray(image.channels(STOKES, path))
    return flat.reshape(*flat.shape[:2], 3, 3)


def stokes_exr_loader(path: Path, config: CaptureConfig, view_name: str | None = None) -> Callable[[], DecodedView]:
    """A loader of one Stokes EXR (`view_name`: its VIEW)."""

    def load() -> DecodedView:
        image = read_linear(path, replace(config.radiometry, encoding="linear"))
        stokes = apply_stokes_config(stokes_of(image, path), config.stokes)
        if seconds := known_seconds(path, view_name, config.radiometry.exposure_s):
            stokes /= np.float32(seconds)
        balance(stokes, config.radiometry)
        view = finished(DecodedView(stokes=stokes, saturated=image.saturated, alpha=image.alpha), path)
        view.faults |= primaries_remark(image.frame)
        if config.stokes == StokesConfig() and is_verbatim(view, image, path, STOKES, config):
            view.verbatim = path
        return view

    return load


def is_verbatim(view: DecodedView, image: LinearImage, path: Path, names: tuple[str, ...], config: CaptureConfig) -> bool:
    """Whether an EXR file already is what decode would write of it: these channels, as they are."""
    settings = {f.name: getattr(config.radiometry, f.name) for f in fields(RadiometryConfig)}
    radiometry = RadiometryConfig(**(settings | {"encoding": None, "saturation": None, "exif_exposure": None}))
    return (
        path.suffix.lower() == ".exr"
        and set(names) <= set(image.names)
        and (image.frame is None or image.frame.is_plain)
        and radiometry == RadiometryConfig()
        and factor_of(config.radiometry, path) == 1
        and not view.faults
    )


FILLED = "not finite: filled from the nearest pixel and marked as saturated; check the export"


def mended(pixels: NDArray[np.float32], saturated: NDArray[np.bool_] | None, path: Path) -> tuple[Any, dict[str, int]]:
    """Fill what is not finite of [H, W, ...] in place: (saturated with those pixels marked, the fault to tell)."""
    holes = fill_holes(pixels)
    if holes is None:
        return saturated, {}
    if holes.all():
        raise UserError(path, "holds no finite pixel", "render or export it again")
    return holes if saturated is None else saturated | holes, {FILLED: int(holes.sum())}


def finished(view: DecodedView, path: Path, image: LinearImage | None = None, whole: bool = False) -> DecodedView:
    """Fill what is not finite, unless its samples were `whole`, and name what a user should know of this file."""
    if not whole:
        pixels = view.stokes if view.stokes is not None else view.rgb
        assert pixels is not None
        view.saturated, faults = mended(pixels, view.saturated, path)
        view.faults |= faults
    if image is not None:
        view.faults |= primaries_remark(image.frame)
    if image is not None and image.doubt is not None:
        view.faults[image.doubt] = 0
    if image is not None and image.orientation != 1:
        turned = f"EXIF rotation {image.orientation} is not applied: frames stay as the sensor saw them"
        view.faults[f"{turned}; check that cameras and masks are of the unrotated pictures"] = 0
    if image is not None and image.bits == 8:
        how = "sRGB" if image.encoding == "srgb" else "linear"
        eight = f"8 bits a channel, taken as {how}: polarisation wants linear 16-bit or float files"
        view.faults[f"{eight}; check radiometry.encoding"] = 0
    return view
