"""Compile what training runs for this machine ahead of the first run: python -m stages.train.compile (`make setup` does).

Kernels are compiled for the arguments that they meet, so that a few steps on a ball that needs no file do it without a list.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pipeline.geometry.cameras import Camera

from .parameters import TrainParameters
from .setup import prepare_training
from .trainer import Trainer
from .views.source_views import SourceView

PIXELS, VIEWS, STEPS = 32, 12, 3
DISTANCE = 4.0  # of the cameras from the middle of a ball of radius 1


def _look_at(direction: np.ndarray) -> np.ndarray:
    """World-to-camera [4, 4] (OpenCV) of a camera along a unit direction [3], looking at the origin."""
    right = np.cross(-direction, [0.0, 1.0, 0.0])
    right /= np.linalg.norm(right)
    out = np.eye(4)
    out[:3, :3] = np.stack([right, np.cross(-direction, right), -direction])
    out[2, 3] = DISTANCE
    return out


def _ball(number: int) -> SourceView:
    """A grey unit ball under light from above, unpolarised."""
    turn, height = 2.4 * number, -0.4 + 1.2 * number / VIEWS  # the golden angle leaves no two views on one line
    direction = np.array([np.cos(turn), height, np.sin(turn)])
    direction /= np.linalg.norm(direction)
    camera = Camera(PIXELS, PIXELS, 1.5 * PIXELS, 1.5 * PIXELS, PIXELS / 2, PIXELS / 2, _look_at(direction))
    rays, along = camera.rays(), camera.rays() @ camera.centre
    root = along**2 - camera.centre @ camera.centre + 1.0
    up = camera.centre[1] + rays[..., 1] * (-along - np.sqrt(np.maximum(root, 0.0)))
    stokes = np.zeros((PIXELS, PIXELS, 3, 3), np.float32)
    stokes[:, :, 0] = np.where(root > 0, 0.3 + 0.2 * up, 0.0)[..., None]
    return SourceView(
        f"{number:03d}", "test" if number % 8 == 0 else "train", camera, stokes,
        (root > 0).astype(np.float32), np.ones(root.shape, bool),
    )  # fmt: skip


def main() -> None:
    """Prepare a training and make a few steps of it, with light between surfaces traced."""
    parameters = replace(TrainParameters(), iterations=200, max_splats=600, hull_resolution=32, environment_resolution=16)
    start = prepare_training([_ball(k) for k in range(VIEWS)], "stokes", {}, "y", parameters, "cpu")
    trainer = Trainer(start.scene, start.pyramids, "stokes", start.frame, parameters, "cpu")
    for _ in range(STEPS):
        trainer.step()
    trainer.validate()


if __name__ == "__main__":
    main()
