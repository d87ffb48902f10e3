"""A light stage's matte: what all lights together make brighter than the empty stage."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from pipeline.capture import LightStageCamera
from pipeline.capture.pixels.linear import read_linear
from pipeline.engine.stage import StageRun
from pipeline.errors import UserError
from stages.masks.background import tidy
from stages.masks.clean_plate import hysteresis

MAX_FRAMES = 64
"""Lights spread over the sphere reach every part of the object; more frames only lower the noise."""
GROW, SEED = 4.0, 10.0
"""Standard deviations of the empty border above its median."""
BORDER = 0.04


def light_stage_matte(camera: LightStageCamera, stage: StageRun) -> NDArray[np.uint8]:
    """Matte 0/255 [H, W] from the all-lights frames if there are any, else from the sum of single lights."""
    frames = camera.full_light or camera.parallel[:: max(1, len(camera.parallel) // MAX_FRAMES)]
    radiometry = stage.capture.config.radiometry
    total = np.zeros((camera.camera.height, camera.camera.width), np.float64)
    with stage.progress.bar(f"matte of {camera.name}", len(frames), "frames") as bar:
        for path in frames:
            image = read_linear(path, radiometry).rgb(path)
            if image.shape[:2] != total.shape:
                raise UserError(
                    path,
                    f"is {image.shape[1]}x{image.shape[0]}, the camera {total.shape[1]}x{total.shape[0]}",
                    "export one size",
                )
            total += np.nan_to_num(image[..., :3]).mean(-1)
            bar.advance()
    mask = matte(total / len(frames))
    if not mask.any():
        raise UserError(camera.parallel[0].parent, "no object stands out from the background", f"add {camera.name}/mask.png")
    return mask.astype(np.uint8) * np.uint8(255)


def matte(sum_of_lights: NDArray) -> NDArray[np.bool_]:
    """Object [H, W] in front of an unlit background, whose level and noise the border shows."""
    height, width = sum_of_lights.shape
    y, x = max(1, int(BORDER * height)), max(1, int(BORDER * width))
    edge = np.concatenate(
        [sum_of_lights[:y].ravel(), sum_of_lights[-y:].ravel(), sum_of_lights[:, :x].ravel(), sum_of_lights[:, -x:].ravel()]
    )
    level = np.median(edge)
    noise = np.median(np.abs(edge - level)) / 0.6745
    # A rendered stage has no noise at all: then a thousandth of the bright object is what counts as light.
    noise = max(noise, 1e-3 * float(np.percentile(sum_of_lights, 99)) / GROW)
    lit = hysteresis((sum_of_lights - level) / noise, GROW, SEED)
    return tidy(lit & ~less_than_half_covered(sum_of_lights - level, lit))


def less_than_half_covered(light: NDArray, lit: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Outline pixels [H, W] that are darker than half of their brightest neighbour inside: mixed with the background."""
    inner = cv2.erode(lit.astype(np.uint8), np.ones((3, 3), np.uint8)).astype(bool)
    brightest = cv2.dilate(np.where(inner, light, 0).astype(np.float32), np.ones((3, 3), np.uint8))
    return lit & ~inner & (light < 0.5 * brightest)
