"""Training data: the decoded views with their cameras and masks, in the training frame, at full or reduced size."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np
import torch
from scipy import ndimage

from pipeline.capture.model import Polarisation as Mode
from pipeline.capture.view_rules import held_back
from pipeline.errors import UserError
from pipeline.formats import dataset_files as files
from pipeline.formats.backdrop import grown
from pipeline.formats.images import read_exr, read_image
from pipeline.geometry.cameras import Camera, load_cameras
from pipeline.geometry.lens import FRAMES

from .training_frame import SceneFrame

Split = Literal["train", "validation", "test", "left_out"]
LEARNT = ("train", "validation")  # the rest is rendered, not learnt from: test views, and views that do not show the object
BLACK_BACKGROUND = 0.01  # background radiance over foreground radiance below which the edge pixels are premultiplied
OPENING = 2.5e-3  # radiance (mean foreground = 0.25) below which no outer side of any dielectric under a sky is: 1/100 of
# the mean, when its mirror reflection alone gives a twentieth
MOST_OPEN = 0.15  # mean share of black pixels above which they are unlit sides, not openings: a teapot's are 0.016, those
# of a bowl seen from all around 0.07, an object lit by one lamp is dark on a third or more
SMALLEST_OPENING = 3  # pixels: fewer are dead pixels
LIT = 4.0  # a patch's level over the usual step between its pixels above which it is an image; noise about black stays below 1
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


@dataclass(frozen=True)
class View:
    """One view ready for training, all in the training frame. P = pixels whose colour counts.

    target [P, S, 3]; colour_weight [P]; pixels [P] flat indices; view_direction, frame_x, frame_y [P, 3] (unit; the
    view direction points at the camera); alpha_target, alpha_weight [H, W]; world_to_camera [4, 4]; intrinsics [3, 3].
    """

    name: str
    split: Split
    camera: Camera
    world_to_camera: torch.Tensor
    intrinsics: torch.Tensor
    pixels: torch.Tensor
    target: torch.Tensor
    colour_weight: torch.Tensor
    inside: torch.Tensor  # [P] bool: fully covered by the object
    view_direction: torch.Tensor
    frame_x: torch.Tensor
    frame_y: torch.Tensor
    alpha_target: torch.Tensor
    alpha_weight: torch.Tensor
    openings: float = 0.0

    @property
    def size(self) -> tuple[int, int]:
        """(height, width)."""
        return self.camera.height, self.camera.width


def load_sources(decode: Path, poses: Path, masks: Path | None, polarisation: str) -> tuple[list[SourceView], Mode]:
    """Every decoded view that has a camera, sorted by name. Raises UserError on what cannot be trained."""
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
            # 2x2 box against the sharp highlights of single edge pixels
            outside.append(np.minimum(lum[ring], np.percentile(lum[edge], 90)).mean())
            inside.append(np.minimum(lum[edge], np.percentile(lum[edge], 90)).mean())
    if not inside or sum(inside) <= 0:
        return 0.0
    return float(np.clip(sum(outside) / sum(inside), 0.0, 1.0))


def exposure_of(sources: list[SourceView]) -> float:
    """Factor that brings the mean foreground radiance of the training views to 0.25, bright outliers left out."""
    values = [s.image[:, :, 0].mean(-1)[(s.mask > 0.5) & s.valid] for s in sources if s.split != "test"]
    lum = np.concatenate(values)
    lum = lum[lum <= np.percentile(lum, 99)] if len(lum) else lum
    mean = float(lum.mean()) if len(lum) else 0.0
    return 0.25 / mean if mean > 0 else 1.0


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


def opening_pixels(source: SourceView, exposure: float) -> np.ndarray:
    """Pixels inside the mask that hold no light at all [H, W]: the image looks through an opening at a surface's back.

    A scan or a model of a vessel is often a surface without thickness, whose back no renderer lights. What a strong sun
    leaves in the shade is as dark beside the rest, but holds an image: patches that are smooth beside their level are lit.
    """
    dark = (np.abs(source.image[:, :, 0]).max(-1) * exposure < OPENING) & (source.mask > 0.99) & source.valid
    parts, count = ndimage.label(dark)
    if not count:
        return dark
    index = np.arange(1, count + 1)
    light = source.image[:, :, 0].mean(-1)
    level = np.asarray(ndimage.median(light, parts, index))
    rough = _roughness(light, parts, index)
    large = ndimage.sum_labels(dark, parts, index) >= SMALLEST_OPENING
    return np.isin(parts, index[large & ~(level > LIT * rough)])


def _roughness(values: np.ndarray, parts: np.ndarray, index: np.ndarray) -> np.ndarray:
    """Usual step between neighbouring pixels that noise alone would make, for each labelled part.

    From second differences, which a slope leaves out, over sqrt(3): a noise's are as much larger than its first ones.
    Parts without three pixels in a row are judged by first differences.
    """
    found = []
    for order, scale in ((2, 3**-0.5), (1, 1.0)):
        steps, owners = [], []
        for image, label in ((values, parts), (values.T, parts.T)):
            ends = label[order:], label[:-order]
            same = (ends[0] == ends[1]) & (label[1 : len(label) - order + 1] == ends[0])
            steps.append((scale * np.abs(np.diff(image, order, axis=0))).ravel())
            owners.append((ends[0] * same).ravel())
        owner = np.concatenate(owners)
        there = np.bincount(owner, minlength=len(index) + 1)[index] > 0
        found.append(np.where(there, ndimage.median(np.concatenate(steps), owner, index), np.nan))
    return np.where(np.isfinite(found[0]), found[0], np.nan_to_num(found[1]))


def openness(source: SourceView, exposure: float) -> np.ndarray:
    """How far each pixel looks into an opening [H, W]: 1 in it, at its rim what is missing of the brightness beside."""
    opening = opening_pixels(source, exposure)
    bright = source.image[:, :, 0].max(-1)
    full = np.asarray(ndimage.maximum_filter(np.where(opening, 0.0, bright), 5))
    rim = grown(opening) & ~opening & (source.mask > 0.99)
    share = 1 - bright / np.maximum(full, 1e-30)  # 0 / 0 where all about is black, which is no rim
    return np.where(opening, 1.0, np.where(rim, np.clip(share, 0.0, 1.0), 0.0))


def has_openings(sources: list[SourceView], exposure: float) -> bool:
    """Whether the training views look into openings: some pixels are black, but not so many that it is for lack of light."""
    shares = [opening_pixels(s, exposure).sum() / max((s.mask > 0.99).sum(), 1) for s in sources if s.split != "test"]
    return bool(shares) and 0 < float(np.mean(shares)) <= MOST_OPEN


def prepare(source: SourceView, frame: SceneFrame, black: bool, device: str = "cpu", openings: bool = False) -> View:
    """A view in the training frame, its counting pixels listed. `openings`: black pixels are openings, not dark surfaces.

    On a black background the ring about the mask counts too (its coverage is left to the model); otherwise the mask's
    own edge pixels, mixed with the background, count for nothing.
    """
    camera = frame.camera(source.camera)
    full = source.mask > 0.99
    any_ = source.mask > 0.01
    wide = grown(any_)
    core = full & ndimage.binary_erosion(full, border_value=1)
    counted = (wide if black else core) & source.valid
    alpha_weight = np.where(core | ~wide, 1.0, 0.0) if black else np.where(core | ~any_, 1.0, 0.25)
    opening = opening_pixels(source, frame.exposure) if openings else np.zeros(full.shape, bool)
    near_opening = grown(opening)
    alpha_weight = np.where(opening, 1.0, np.where(near_opening, 0.0, alpha_weight))
    index = np.flatnonzero(counted)
    rays = camera.rays().reshape(-1, 3)[index]
    frame_x, frame_y = (a.reshape(-1, 3)[index] for a in camera.stokes_frame())
    image = source.image * frame.exposure
    image = image.reshape(-1, *image.shape[2:])[index]

    def tensor(a: np.ndarray) -> torch.Tensor:
        return torch.as_tensor(np.ascontiguousarray(a, np.float32), device=device)

    return View(
        name=source.name,
        split=source.split,
        camera=camera,
        world_to_camera=tensor(camera.world_to_camera),
        intrinsics=tensor(camera.intrinsics),
        pixels=torch.as_tensor(index, device=device),
        target=tensor(image),
        colour_weight=torch.ones(len(index), device=device),
        inside=torch.as_tensor((full & ~near_opening).reshape(-1)[index], device=device),
        view_direction=tensor(-rays),
        frame_x=tensor(frame_x),
        frame_y=tensor(frame_y),
        alpha_target=tensor(np.where(opening, 0.0, source.mask)),
        alpha_weight=tensor(alpha_weight),
        openings=float(opening.sum() / max(full.sum(), 1)),
    )


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
