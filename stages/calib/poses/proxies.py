"""What COLMAP sees: 8-bit, display-encoded pictures that do not depend on the polariser, in one folder per camera."""

from __future__ import annotations

from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pipeline.engine.stage import StageRun
from pipeline.formats.given_mask import read_given
from pipeline.formats.image_output import write_fault
from pipeline.formats.images import read_image, srgb_encode, write_mask


@dataclass(frozen=True)
class Proxy:
    """One view as COLMAP knows it: `name` is its path below the picture folder, `group` its camera folder."""

    view: str
    name: str
    group: str
    camera: str
    width: int
    height: int


def write_proxies(stage: StageRun, folder: Path, frames: dict[str, dict]) -> list[Proxy]:
    """Write every decoded view to FOLDER/NUMBER_WxH/VIEW.tif; all of a camera share one exposure, so that it is kept.

    Folders go by the camera's number in sorted order: its name is the capture's, and may be any text, a path too.
    """
    number = {camera: k for k, camera in enumerate(sorted({frame["camera"] for frame in frames.values()}))}
    exposure = {camera: _exposure(stage, views) for camera, views in _by_camera(frames).items()}

    def one(item: tuple[str, dict]) -> Proxy:
        view, frame = item
        group = f"{number[frame['camera']]:03d}_{frame['width']}x{frame['height']}"
        name = f"{group}/{view.removeprefix(frame['camera'] + '_')}.tif"  # equal names under two cameras: one head
        s0 = _radiance(stage, frame["file"])
        write_tiff(folder / name, encode(s0, exposure[frame["camera"]]))
        return Proxy(view, name, group, frame["camera"], frame["width"], frame["height"])

    with ThreadPoolExecutor(max(1, stage.jobs)) as pool:
        return list(pool.map(one, sorted(frames.items())))


LEVELS = 4096
TABLE = (srgb_encode(np.arange(LEVELS) / (LEVELS - 1)) * 255 + 0.5).astype(np.uint8)
"""sRGB of 12-bit linear levels: finer than an 8-bit code everywhere but in the two darkest."""


def encode(radiance: NDArray[np.float32], exposure: float) -> NDArray[np.uint8]:
    """Linear [H, W, 3] as 8-bit sRGB."""
    scaled = radiance * np.float32(exposure * (LEVELS - 1))
    return TABLE[np.clip(np.nan_to_num(scaled), 0, LEVELS - 1).astype(np.uint16)]


def write_tiff(path: Path, pixels: NDArray[np.uint8]) -> None:
    """Uncompressed, as it is read once and thrown away. Raises UserError when it cannot be written."""
    import OpenImageIO as oiio

    path.parent.mkdir(parents=True, exist_ok=True)
    spec = oiio.ImageSpec(pixels.shape[1], pixels.shape[0], 3, "uint8")
    spec.attribute("compression", "none")
    out = oiio.ImageOutput.create(str(path))
    if out is None or not out.open(str(path), spec) or not out.write_image(np.ascontiguousarray(pixels)) or not out.close():
        raise write_fault(path, oiio.geterror() if out is None else out.geterror())


def write_masks(stage: StageRun, folder: Path, proxies: Iterable[Proxy]) -> Path | None:
    """Masks that the capture gives, as COLMAP wants them (NAME.tif.png), for every view or not at all; None if none."""
    masks = stage.capture.masks
    if not isinstance(masks, dict) or not stage.parameters.use_masks:
        return None
    proxies = list(proxies)
    if any(p.view not in masks for p in proxies):
        return None  # COLMAP drops images without a mask, silently
    for p in proxies:
        write_mask(folder / f"{p.name}.png", read_given(masks[p.view]).inside)
    return folder


def _by_camera(frames: dict[str, dict]) -> dict[str, list[dict]]:
    out: dict[str, list[dict]] = {}
    for _, frame in sorted(frames.items()):
        out.setdefault(frame["camera"], []).append(frame)
    return out


def _exposure(stage: StageRun, frames: list[dict]) -> float:
    """Factor that makes the median of some of a camera's frames middle grey, without blowing up their bright end:
    a dark surround is no reason to."""
    middle, bright = [], []
    for frame in frames[:: max(1, len(frames) // 3)][:3]:
        grey = _radiance(stage, frame["file"])[::4, ::4].mean(-1)
        middle.append(np.median(grey))
        bright.append(np.percentile(grey, 95))
    level = float(np.median(middle))
    top = float(np.median(bright))
    return min(0.18 / level if level > 0 else np.inf, 0.8 / top) if top > 0 else 1.0


def _radiance(stage: StageRun, file: str) -> NDArray[np.float32]:
    stokes = stage.capture.polarisation == "stokes"
    return read_image(stage.inputs["decode"] / file, ("S0.R", "S0.G", "S0.B") if stokes else ("R", "G", "B"))
