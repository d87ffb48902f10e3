"""What leaves each Gaussian towards a camera, read off the model's image of that camera."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

from ..render_view import LAYER, LEAST_ALPHA, Rendered
from ..views.view import View

SEEN = 0.5  # opacity from which a pixel shows the object and not its outline
LEAST_FACING = 0.05  # cosine below which a disc is narrower than its neighbours' blur; mirrored light rises up to there


@dataclass(frozen=True)
class Samples:
    """One camera's, in the training frame.

    centre [3], world_to_camera [4, 4], intrinsics [3, 3], size (height, width). rows [M]: of the Gaussians that it sees; pixels
    [M, 2]: where in the image (column, row; pixel centres at whole numbers); weight [M]: cosine towards the camera;
    radiance [M, 3]: in the training exposure, opacity divided out.
    """

    centre: NDArray[np.float64]
    world_to_camera: torch.Tensor
    intrinsics: torch.Tensor
    size: tuple[int, int]
    rows: NDArray[np.int64]
    pixels: NDArray[np.float32]
    weight: NDArray[np.float32]
    radiance: NDArray[np.float32]


def samples_of(rendered: Rendered, view: View) -> Samples:
    """The Gaussians whose centres a view shows: turned to the camera, and not behind what is nearer."""
    splats, g = rendered.splats, rendered.gbuffer
    height, width = view.size
    means, normals = (v.detach().cpu().double().numpy() for v in (splats.means, splats.normals))
    matrix = view.world_to_camera.cpu().double().numpy()
    centre = -matrix[:3, :3].T @ matrix[:3, 3]
    local = means @ matrix[:3, :3].T + matrix[:3, 3]
    towards = centre - means
    facing = (towards * normals).sum(1) / np.maximum(np.linalg.norm(towards, axis=1), 1e-12)
    projected = local @ view.intrinsics.cpu().double().numpy().T
    pixels = projected[:, :2] / np.maximum(projected[:, 2:], 1e-9) - 0.5
    inside = ((pixels >= 0) & (pixels <= (width - 1, height - 1))).all(1)
    rows = np.flatnonzero((local[:, 2] > 0) & (facing > LEAST_FACING) & inside)
    alpha = g.alpha_image.cpu().numpy()
    shown = at(np.stack([alpha, g.raster.depth_median.cpu().numpy()], -1), np.round(pixels[rows]))
    near = LAYER * float(splats.scales.median())
    kept = (shown[:, 0] > SEEN) & (np.abs(shown[:, 1] - local[rows, 2]) < near / facing[rows])
    rows = rows[kept]
    image = np.zeros((height * width, 4), np.float32)
    index = view.pixels.cpu().numpy()
    image[index, :3] = np.nan_to_num(rendered.stokes[:, 0].cpu().numpy())
    image[index, 3] = g.alpha.cpu().numpy()
    found = at(image.reshape(height, width, 4), pixels[rows])
    radiance = found[:, :3] / np.maximum(found[:, 3:], LEAST_ALPHA)
    place = centre, view.world_to_camera, view.intrinsics, view.size
    values = (v.astype(np.float32) for v in (pixels[rows], facing[rows], radiance))
    return Samples(*place, rows, *values)


def at(image: NDArray, pixels: NDArray) -> NDArray[np.float32]:
    """An image [H, W, C] between its pixels [M, 2] (column, row), linearly: [M, C]."""
    place = pixels[:, ::-1].T
    parts = [map_coordinates(image[..., k], place, order=1, mode="nearest") for k in range(image.shape[-1])]
    return np.stack(parts, -1).astype(np.float32)
