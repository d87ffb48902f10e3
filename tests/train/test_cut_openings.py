"""Cutting a start surface open where the views look through it."""

from __future__ import annotations

import numpy as np

from pipeline.geometry.cameras import Camera
from stages.train.initialise.hull import HullMesh, smoothed
from stages.train.initialise.openings import DEPTH, OpeningView, cut_openings

from .conftest import look_at

HOLE = 0.25  # radius of a round hole in the top of the unit ball, seen from above
SIZE, FOCAL, DISTANCE = 80, 150.0, 4.0
PIXEL = DISTANCE / FOCAL
WALL = 3 * PIXEL  # how far the hole's upright wall reaches down


def ball() -> HullMesh:
    from skimage.measure import marching_cubes

    axis = np.linspace(-1.2, 1.2, 49)
    grid = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), -1)
    vertices, triangles, *_ = marching_cubes(1 - np.linalg.norm(grid, axis=-1), 0.0, spacing=(axis[1] - axis[0],) * 3)
    return smoothed(vertices - 1.2, triangles[:, ::-1].astype(np.int64), rounds=2)


def views(radius: float = HOLE) -> list[OpeningView]:
    """A ring of views from above; each pixel's share of rays that enter the ball through the hole and miss its wall."""
    out = []
    for k in range(8):
        turn = 2 * np.pi * k / 8
        centre = np.array([0.35 * np.cos(turn), 1.0, 0.35 * np.sin(turn)])
        camera = Camera(SIZE, SIZE, FOCAL, FOCAL, SIZE / 2, SIZE / 2, look_at(centre, DISTANCE))
        rays = camera.resized(4 * SIZE, 4 * SIZE).rays().reshape(-1, 3)
        b = rays @ camera.centre
        root = b * b - camera.centre @ camera.centre + 1
        hit = camera.centre + rays * (-b - np.sqrt(np.maximum(root, 0)))[:, None]
        below = hit + rays * (WALL / -rays[:, 1:2])
        inside = [np.hypot(p[:, 0], p[:, 2]) < radius for p in (hit, below)]
        through = (root > 0) & (hit[:, 1] > 0) & inside[0] & inside[1]
        out.append(OpeningView(camera, through.reshape(SIZE, 4, SIZE, 4).mean((1, 3))))
    return out


def test_a_hole_gets_its_rim_and_walls_and_no_film_or_floor() -> None:
    cut = cut_openings(ball(), views(), PIXEL)
    assert cut is not None
    used = cut.vertices[np.unique(cut.triangles)]
    across = np.hypot(used[:, 0], used[:, 2])
    top = used[:, 1] > 0
    assert not (top & (across < HOLE - 1.5 * PIXEL)).any()  # neither film nor floor
    wall = top & (np.abs(across - HOLE) < PIXEL) & (np.linalg.norm(used, axis=-1) < 1 - PIXEL)
    assert wall.sum() > 50
    assert used[wall][:, 1].min() > np.sqrt(1 - HOLE**2) - (DEPTH + 2) * PIXEL
    normals = cut.normals[np.unique(cut.triangles)][wall]
    assert np.median((normals * used[wall])[:, [0, 2]].sum(-1) / across[wall]) < -0.7  # towards the hole
    elsewhere = used[~top]
    assert np.abs(np.linalg.norm(elsewhere, axis=-1) - 1).max() < 0.02


def test_without_an_opening_nothing_is_cut() -> None:
    assert cut_openings(ball(), views(0.0), PIXEL) is None


def test_one_view_alone_opens_nothing() -> None:
    seen = [v if k == 0 else OpeningView(v.camera, np.zeros_like(v.hole_coverage)) for k, v in enumerate(views())]
    assert cut_openings(ball(), seen, PIXEL) is None
