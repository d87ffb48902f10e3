"""The object is what all cameras look at: colours and the visual hull learn from each other.

After Campbell et al., "Automatic 3D object segmentation in multiple views using volumetric graph-cuts" (2010): the views
fixate the object, so a ball around the point that they look at starts the labels. Then, in turn: colours of object and
background are learnt from the labels; every voxel adds up what the views say of it; a pixel is object if its colour
says so and some voxel on its ray is.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from pipeline.geometry.axes import nearest_to_lines
from pipeline.geometry.cameras import Camera
from stages.masks.colour_model import MAX_LOG_ODDS, ColourSpace, colour_log_odds
from stages.masks.volume import NOTHING, Grid, Projections, ray_maxima, stack_padded, voxel_scores

ROUNDS = 6
COARSE_SIZE, COARSE_GRID, FINE_GRID = 240, 96, 160
BYSTANDER = 0.9
"""Chance that an empty voxel near the object still falls on the object in a view, before or behind it. High, because
views are not independent there: one view that sees past a voxel must outweigh many that do not."""
BALL_MARGIN = 1.15
"""The object may reach this far out of the ball that three quarters of the views hold whole."""
SMOOTHING_PX = 0.7


@dataclass(frozen=True)
class Fixation:
    """The ball that the cameras look at: centre [3] and radius, world units."""

    centre: NDArray[np.float64]
    radius: float


def fixation(cameras: list[Camera]) -> Fixation | None:
    """The point nearest to all optical axes and the radius that three quarters of the images hold; None if there is none."""
    axes = np.stack([c.world_to_camera[2, :3] for c in cameras])
    centre = nearest_to_lines(np.stack([c.centre for c in cameras]), axes)
    if centre is None:
        return None
    radii = []
    for c in cameras:
        (u, v), depth = c.project(centre)
        margin = min(u, v, c.width - u, c.height - v) / c.fx
        radii.append(margin * depth if depth > 0 else -1.0)
    radius = float(np.percentile(radii, 25))
    return Fixation(centre, radius) if radius > 0 else None


def segment(images: list[NDArray[np.float32]], cameras: list[Camera], known: dict[int, NDArray[np.bool_]],
            max_size: int) -> list[NDArray[np.bool_]] | None:  # fmt: skip
    """Object masks [h, w] of linear images [h, w, 3] with their cameras; `known` are masks by index.

    None where the cameras do not look at one thing. Deterministic.
    """
    ball = fixation(cameras)
    if ball is None:
        return None
    small = [_shrunk(i, c, COARSE_SIZE) for i, c in zip(images, cameras)]
    coarse = Labels([s[0] for s in small], [s[1] for s in small], ball, COARSE_GRID, known)
    for _ in range(ROUNDS):
        coarse.learn()
    large = [_shrunk(i, c, max_size) for i, c in zip(images, cameras)]
    fine = Labels([s[0] for s in large], [s[1] for s in large], ball, FINE_GRID, known)
    fine.probability = [
        cv2.resize(p, (c.width, c.height), interpolation=cv2.INTER_LINEAR) for p, c in zip(coarse.probability, fine.cameras)
    ]
    fine.learn()
    return [tidy(_full_size(p, i)) for p, i in zip(fine.log_odds, images)]


class Labels:
    """Soft labels of all views at one resolution, and one round of learning."""

    def __init__(self, images: list[NDArray[np.float32]], cameras: list[Camera], ball: Fixation, count: int,
                 known: dict[int, NDArray[np.bool_]]) -> None:  # fmt: skip
        self.cameras, self.projections = cameras, Projections.of(cameras)
        self.space = ColourSpace.of(images)
        self.bins = [self.space.bins(image) for image in images]
        edge = 2 * BALL_MARGIN * ball.radius
        self.grid = Grid(ball.centre - edge / 2, edge / count, count)
        distance = [_ray_distance(c, ball) for c in cameras]
        self.reachable = [d < BALL_MARGIN for d in distance]
        self.probability: list[NDArray] = [np.clip(0.8 * (1 - d), 0, 1) for d in distance]
        self.log_odds: list[NDArray] = []
        self.known = {k: cv2.resize(m.astype(np.float32), (cameras[k].width, cameras[k].height)) for k, m in known.items()}
        self._apply_known()

    def learn(self) -> None:
        """Colours from labels, voxels from colours, labels from both."""
        colour = colour_log_odds(self.bins, self.probability)
        for k, mask in self.known.items():
            colour[k] = (2 * mask.astype(np.float64) - 1) * MAX_LOG_ODDS
        blurred = [_smooth(c) for c in colour]
        for b, reachable in zip(blurred, self.reachable):
            b[~reachable] = -MAX_LOG_ODDS
        votes = [(-np.log(BYSTANDER + (1 - BYSTANDER) * np.exp(-b))).astype(np.float32) for b in blurred]
        stacked = stack_padded(votes)
        volume = voxel_scores(stacked, self.projections, self.grid)
        hull = ray_maxima(volume, stack_padded(self.reachable, bool), self.projections, self.grid)
        self.log_odds = []
        for k, (c, vote, reachable) in enumerate(zip(colour, votes, self.reachable)):
            others = hull[k, : c.shape[0], : c.shape[1]] - vote  # a view is not its own witness
            odds = _smooth(c + np.clip(others / 2, -6, 4))  # half: votes of neighbouring views repeat each other
            odds[~reachable | (others < NOTHING / 2)] = -9
            self.log_odds.append(odds)
        self.probability = [1 / (1 + np.exp(-odds)) for odds in self.log_odds]
        self._apply_known()

    def _apply_known(self) -> None:
        for k, mask in self.known.items():
            self.probability[k] = mask.astype(np.float64)
            if self.log_odds:
                self.log_odds[k] = (2 * mask.astype(np.float64) - 1) * 9


def _ray_distance(camera: Camera, ball: Fixation) -> NDArray[np.float64]:
    """Distance of each pixel's ray from the ball's centre, in radii [H, W]."""
    return np.linalg.norm(np.cross(camera.rays(), ball.centre - camera.centre), axis=-1) / ball.radius


def _smooth(image: NDArray) -> NDArray:
    return cv2.GaussianBlur(image, (0, 0), SMOOTHING_PX)


def _shrunk(image: NDArray[np.float32], camera: Camera, longest: int) -> tuple[NDArray[np.float32], Camera]:
    """Image and camera with the longer side at most `longest`."""
    factor = longest / max(image.shape[:2])
    if factor >= 1:
        return image, camera
    width, height = max(1, round(image.shape[1] * factor)), max(1, round(image.shape[0] * factor))
    small = cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA).astype(np.float32)
    return small, camera.resized(width, height)


def _full_size(log_odds: NDArray, image: NDArray[np.float32]) -> NDArray[np.bool_]:
    if log_odds.shape == image.shape[:2]:
        return log_odds > 0
    from stages.masks.guided import guided_upsample

    return guided_upsample(log_odds, image) > 0


def tidy(mask: NDArray[np.bool_], specks: float = 1e-3) -> NDArray[np.bool_]:
    """Without parts or holes smaller than `specks` of the object's area: noise, not thin parts."""
    smallest = max(2, int(specks * mask.sum()))
    out = mask.copy()
    for value in (True, False):
        _, labels, stats, _ = cv2.connectedComponentsWithStats((out == value).astype(np.uint8), connectivity=8 if value else 4)
        small = stats[:, cv2.CC_STAT_AREA] < smallest
        small[0] = False
        out[small[labels]] = not value
    return out
