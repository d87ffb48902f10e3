"""What the training views saw at given points of space, and from where."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy import ndimage

from pipeline.geometry.cameras import Camera
from pipeline.shading import Occlusion

from ..views.losses import GAMMA, TOE
from ..views.polarisers import PolariserBank
from ..views.view import View

BLUR = 0.8  # pixels: takes the single pixel's noise away and keeps what a pixel's shift changes
MOST_VIEWS = 48  # evenly chosen from more: every further view costs time and says little


@dataclass(frozen=True)
class ViewImage:
    """One view as a lookup: values [H, W, C] (C = 9 for full Stokes, else 3), cover [H, W], Stokes axes [H, W, 3] each.

    mix: None for full Stokes, else what the camera's polariser adds to s0: (m1, m2) with I = s0 + m1 s1 + m2 s2.
    own [H, W, 10]: what the object does to its own light there: shadow, bounced, seen (rgb each), unblocked.
    """

    camera: Camera
    values: np.ndarray
    cover: np.ndarray
    frame_x: np.ndarray
    frame_y: np.ndarray
    mix: tuple[float, float] | None
    own: np.ndarray


class Observations(NamedTuple):
    """What up to V views saw of P points: views [P] of each; that many rows of each hold.

    values [P, V, C]; slope [P, V, 3] of the display encoding there; towards, frame_x, frame_y [P, V, 3]; mix [P, V, 2];
    own [P, V, 10].
    """

    views: np.ndarray
    values: np.ndarray
    slope: np.ndarray
    towards: np.ndarray
    frame_x: np.ndarray
    frame_y: np.ndarray
    mix: np.ndarray
    own: np.ndarray


def view_images(
    views: Sequence[View], mode: str, bank: PolariserBank | None, occlusion: Mapping[str, Occlusion]
) -> list[ViewImage]:
    """Lookups of the training views, blurred inside the mask; `occlusion` by view as traced on the surface so far."""
    chosen = [v for v in views if v.split != "test"]
    if len(chosen) > MOST_VIEWS:
        chosen = [chosen[k] for k in np.linspace(0, len(chosen) - 1, MOST_VIEWS).round().astype(int)]
    return [_view_image(v, mode, bank, occlusion.get(v.name)) for v in chosen]


def _view_image(view: View, mode: str, bank: PolariserBank | None, occlusion: Occlusion | None) -> ViewImage:
    height, width = view.size
    pixels = view.pixels.cpu().numpy()
    target = view.target.cpu().numpy()
    mix = None
    if mode == "polarisers" and bank is not None:
        values, mix = 2 * target[:, 0], bank.mix(view.camera.name)
    elif mode == "stokes":
        values = target.reshape(len(target), 9)
    else:
        values, mix = target[:, 0], (0.0, 0.0)

    def image(rows: np.ndarray) -> np.ndarray:
        out = np.zeros((height * width, rows.shape[1]), np.float32)
        out[pixels] = rows
        return out.reshape(height, width, -1)

    inside = image(view.inside.cpu().numpy()[:, None].astype(np.float32))
    weight = ndimage.gaussian_filter(inside, (BLUR, BLUR, 0))
    blurred = ndimage.gaussian_filter(image(values) * inside, (BLUR, BLUR, 0)) / np.maximum(weight, 1e-3)
    axes = image(view.frame_x.cpu().numpy()), image(view.frame_y.cpu().numpy())
    own = np.zeros((len(pixels), 10), np.float32)
    if occlusion is None:
        own[:, :3], own[:, 9] = 1.0, 1.0
    else:
        parts = (occlusion.shadow, occlusion.bounced, occlusion.seen, occlusion.unblocked[:, None])
        own = np.concatenate([part.cpu().numpy() for part in parts], -1)
    return ViewImage(view.camera, blurred, inside[..., 0], *axes, mix, image(own))


def observe(images: Sequence[ViewImage], points: np.ndarray, visible: np.ndarray, towards: np.ndarray) -> Observations:
    """Look points [P, 3] up in every view that sees them: visible [V, P], towards [V, P, 3] unit vectors to the cameras."""
    count, most = len(points), len(images)
    channels = images[0].values.shape[-1]
    number = np.zeros(count, np.int64)
    values = np.zeros((count, most, channels), np.float32)
    slope, away, axis_x, axis_y = (np.zeros((count, most, 3), np.float32) for _ in range(4))
    mix = np.zeros((count, most, 2), np.float32)
    own = np.zeros((count, most, 10), np.float32)
    for k, image in enumerate(images):
        pixels, depth = image.camera.project(points)
        height, width = image.cover.shape
        seen = visible[k] & (depth > 0) & (pixels >= 0).all(-1) & (pixels < (width, height)).all(-1)
        rows = np.flatnonzero(seen)
        column, line = pixels[rows, 0].astype(np.int64), pixels[rows, 1].astype(np.int64)
        where = np.clip(pixels[rows, 1] - 0.5, 0, height - 1), np.clip(pixels[rows, 0] - 0.5, 0, width - 1)
        covered = ndimage.map_coordinates(image.cover, where, order=1, mode="nearest") > 0.98
        rows, column, line, where = rows[covered], column[covered], line[covered], tuple(a[covered] for a in where)
        at = number[rows]
        found = [ndimage.map_coordinates(image.values[..., c], where, order=1, mode="nearest") for c in range(channels)]
        values[rows, at] = np.stack(found, -1)
        slope[rows, at] = GAMMA * (np.maximum(values[rows, at, :3], 0) + TOE) ** (GAMMA - 1)
        away[rows, at] = towards[k, rows]
        axis_x[rows, at], axis_y[rows, at] = image.frame_x[line, column], image.frame_y[line, column]
        own[rows, at] = image.own[line, column]
        if image.mix is not None:
            mix[rows, at] = image.mix
        number[rows] += 1
    return Observations(number, values, slope, away, axis_x, axis_y, mix, own)
