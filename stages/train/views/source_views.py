"""The decoded views with their cameras and masks as stored: loading, the split into test and training views, levels."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np
from scipy import ndimage

from pipeline.capture.model import Polarisation as Mode
from pipeline.capture.view_rules import held_back
from pipeline.errors import UserError
from pipeline.formats import dataset_files as files
from pipeline.formats.images import read_exr, read_image
from pipeline.geometry.cameras import Camera, load_cameras
from pipeline.geometry.lens import FRAMES

Split = Literal["train", "validation", "test", "left_out"]
LEARNT = ("train", "validation")  # the rest is rendered, not learnt from: test views, and views that do not show the object
BLACK_BACKGROUND = 0.01  # background radiance over foreground radiance below which the edge pixels are premultiplied
MEAN_EXPOSED = 0.25  # mean foreground radiance in the training exposure: a photograph's middle grey, a little up
FEWEST_VIEWS = 4  # below this neither a hull nor an environment is determined at all


@dataclass(frozen=True)
class SourceView:
    """One decoded view as stored: image [H, W, S, 3] (S = 3 Stokes components or 1), mask and validity [H, W]."""

    name: str
    split: Split
    camera: Camera
    image: np.ndarray
    mask: np.ndarray  # coverage 0..1
    valid: np.ndarray  # bool: neither saturated nor non-finite


def load_sources(decode: Path, poses: Path, masks: Path | None, polarisation: str) -> tuple[list[SourceView], Mode]:
    """Every decoded view that has a camera, sorted by name, and what the views hold.

    Args:
        decode: folder with frames.json and frames/ (`pipeline.geometry.lens.frames_folder`).
        poses: folder with cameras.json.
        masks: folder with VIEW.png; None: the object fills every view.
        polarisation: "auto", or what of the data to use.

    Raises:
        UserError: too few views, a mask of another size, or data that do not hold what is asked for.
    """
    index_path = decode / FRAMES
    index = json.loads(index_path.read_text())
    cameras = load_cameras(poses / files.CAMERAS)
    mode: Mode = index["polarisation"]
    if polarisation != "auto" and polarisation != mode:
        mode = _reduced_mode(mode, polarisation, index_path)
    names = sorted(index["views"])
    parts = held_back(names, index.get("parts"))
    sources = []
    for name in names:
        if name not in cameras:
            continue
        split: Split = parts.get(name, "train")
        source = _load(name, index["views"][name], cameras[name], decode, masks, split, mode)
        unseen = split == "train" and not (source.mask > 0.5).any()
        sources.append(replace(source, split="left_out") if unseen else source)
    usable = [s for s in sources if s.split == "train" and ((s.mask > 0.5) & s.valid).sum() > 20]
    if len(usable) < FEWEST_VIEWS:
        raise UserError(
            index_path,
            f"only {len(usable)} training views show the object unsaturated",
            f"training needs at least {FEWEST_VIEWS}, better 20 around the object; check masks and exposure",
        )
    return sources, mode


def _reduced_mode(stored: str, wanted: str, path: Path) -> Mode:
    if stored == "stokes" and wanted == "none":
        return "none"
    raise UserError(path, f"the frames hold '{stored}', not '{wanted}'", "set train.polarisation to auto or none")


def _load(name: str, entry: dict, camera: Camera, decode: Path, masks: Path | None, split: Split, mode: Mode) -> SourceView:
    channels = read_exr(decode / entry["file"])
    height, width = next(iter(channels.values())).shape
    camera = replace(camera.resized(width, height), name=entry.get("camera") or camera.name)
    if "S0.R" in channels:
        parts = 3 if mode == "stokes" else 1
        image = np.stack([np.stack([channels[f"S{k}.{c}"] for c in "RGB"], -1) for k in range(parts)], -2)
    else:
        image = np.stack([channels[c] for c in "RGB"], -1)[:, :, None]
    valid = np.isfinite(image).all((-1, -2))
    if entry.get("saturated"):
        valid &= read_image(decode / entry["saturated"])[..., 0] < 0.5
    mask = np.ones((height, width), np.float32)
    if masks is not None:
        mask = read_image(files.mask(masks, name))[..., 0]
        if mask.shape != (height, width):
            raise UserError(files.mask(masks, name), f"is {mask.shape[::-1]}, its image {width}x{height}", "redo the masks")
    return SourceView(name, split, camera, np.nan_to_num(image, posinf=0.0, neginf=0.0), mask, valid)


def with_validation(sources: list[SourceView], every: int) -> list[SourceView]:
    """The sources with some training views marked as validation; `every` 0 chooses about one in 14, at least one of 12.

    Where the capture's own tables name validation views, these are they.
    """
    if any(s.split == "validation" for s in sources):
        return sources
    training = [s.name for s in sources if s.split == "train" and (s.mask > 0.99).any()]
    if every == 0:
        every = 14 if len(training) >= 12 else 0
    held = set(training[every // 2 :: every]) if every else set()
    return [replace(s, split="validation") if s.name in held else s for s in sources]


def halved(source: SourceView) -> SourceView:
    """The view at half size: 2x2 averages (odd edges are padded by repetition and keep their geometry)."""
    height, width = source.mask.shape
    pad = (height % 2, width % 2)

    def half(a: np.ndarray) -> np.ndarray:
        a = np.pad(a, [(0, pad[0]), (0, pad[1])] + [(0, 0)] * (a.ndim - 2), mode="edge")
        return a.reshape(a.shape[0] // 2, 2, a.shape[1] // 2, 2, *a.shape[2:]).mean((1, 3))

    camera = source.camera
    camera = replace(
        camera,
        width=(width + 1) // 2,
        height=(height + 1) // 2,
        fx=camera.fx / 2,
        fy=camera.fy / 2,
        cx=camera.cx / 2,
        cy=camera.cy / 2,
    )
    valid = half(source.valid.astype(np.float32)) > 0.99
    return replace(source, camera=camera, image=half(source.image), mask=half(source.mask), valid=valid)


def background_is_black(sources: list[SourceView]) -> bool:
    """Whether the images are black away from the object, so that edge pixels hold radiance times coverage."""
    ratios = []
    for s in sources:
        far = ~ndimage.binary_dilation(s.mask > 0.02, iterations=3)
        if far.sum() > 10 and (s.mask > 0.5).any():
            inside = np.abs(s.image[s.mask > 0.5]).mean()
            ratios.append(np.abs(s.image[far]).mean() / max(float(inside), 1e-30))  # a wholly black object counts as none
    return bool(ratios) and float(np.median(ratios)) < BLACK_BACKGROUND


def edge_offset(sources: list[SourceView]) -> float:
    """How far (pixels) the object reaches beyond the masks: 0.5 where masks hold only fully covered pixels, 0 at best.

    From black-background images: mean radiance of the ring just outside over that just inside.
    """
    outside, inside = [], []
    for s in sources:
        mask = s.mask > 0.5
        lum = s.image[:, :, 0].mean(-1)
        ring = ndimage.binary_dilation(mask) & ~mask
        edge = mask & ~ndimage.binary_erosion(mask, border_value=1)
        if ring.any() and edge.any():
            # cut off at the edge's 90th percentile: one sharp highlight would outweigh the whole ring
            outside.append(np.minimum(lum[ring], np.percentile(lum[edge], 90)).mean())
            inside.append(np.minimum(lum[edge], np.percentile(lum[edge], 90)).mean())
    if not inside or sum(inside) <= 0:
        return 0.0
    return float(np.clip(sum(outside) / sum(inside), 0.0, 1.0))


def exposure_of(sources: list[SourceView]) -> float:
    """Factor that brings the mean foreground radiance of the training views to MEAN_EXPOSED, bright outliers left out."""
    values = [s.image[:, :, 0].mean(-1)[(s.mask > 0.5) & s.valid] for s in sources if s.split != "test"]
    lum = np.concatenate(values)
    lum = lum[lum <= np.percentile(lum, 99)] if len(lum) else lum
    mean = float(lum.mean()) if len(lum) else 0.0
    return MEAN_EXPOSED / mean if mean > 0 else 1.0
