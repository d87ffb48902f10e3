"""What COLMAP sees: 8-bit, display-encoded pictures that do not depend on the polariser, in one folder per camera."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pipeline.images import read_image, srgb_encode, write_mask, write_png
from pipeline.stage import StageRun


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
    """Write every decoded view to FOLDER/CAMERA/VIEW.png; all of a camera share one exposure, so that it is kept."""
    exposure = {camera: _exposure(stage, views) for camera, views in _by_camera(frames).items()}
    out = []
    for view, frame in sorted(frames.items()):
        group = f"{frame['camera']}_{frame['width']}x{frame['height']}"
        name = f"{group}/{view}.png"
        s0 = _radiance(stage, frame["file"])
        write_png(folder / name, srgb_encode(s0 * exposure[frame["camera"]]))
        out.append(Proxy(view, name, group, frame["camera"], frame["width"], frame["height"]))
    return out


def write_masks(stage: StageRun, folder: Path, proxies: Iterable[Proxy]) -> Path | None:
    """Masks that the capture gives, as COLMAP wants them (NAME.png.png), for every view or not at all; None if none."""
    masks = stage.capture.masks
    if not isinstance(masks, dict) or not stage.parameters.use_masks:
        return None
    proxies = list(proxies)
    if any(p.view not in masks for p in proxies):
        return None  # COLMAP drops images without a mask, silently
    for p in proxies:
        mask = read_image(masks[p.view])[..., 0] > 0.5
        write_mask(folder / f"{p.name}.png", mask)
    return folder


def _by_camera(frames: dict[str, dict]) -> dict[str, list[dict]]:
    out: dict[str, list[dict]] = {}
    for _, frame in sorted(frames.items()):
        out.setdefault(frame["camera"], []).append(frame)
    return out


def _exposure(stage: StageRun, frames: list[dict]) -> float:
    """Factor that makes the median of some of a camera's frames middle grey."""
    some = frames[:: max(1, len(frames) // 4)]
    middle = float(np.median([np.median(_radiance(stage, f["file"])[::4, ::4].mean(-1)) for f in some]))
    bright = float(np.median([np.percentile(_radiance(stage, f["file"])[::4, ::4].mean(-1), 95) for f in some]))
    if bright <= 0:
        return 1.0
    # Dark surrounds must not blow up the object: the bright end stays below white.
    return min(0.18 / middle if middle > 0 else np.inf, 0.8 / bright)


def _radiance(stage: StageRun, file: str) -> NDArray[np.float32]:
    stokes = stage.capture.polarisation == "stokes"
    return read_image(stage.inputs["decode"] / file, ("S0.R", "S0.G", "S0.B") if stokes else ("R", "G", "B"))
