"""A view as training compares with it: its counting pixels, in the training frame."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch
from scipy import ndimage

from pipeline.formats.backdrop import grown
from pipeline.geometry.cameras import Camera

from .opening_pixels import opening_pixels
from .source_views import SourceView, Split
from .training_frame import SceneFrame

COVERED, EMPTY = 0.99, 0.01  # mask values from which a pixel is wholly the object's, and below which nothing of it: 8-bit
# masks round by 0.002, and resampled ones ring by a little more
EDGE_WEIGHT = 0.25  # of a mask's edge pixels in L_mask: of all on a bright background, where the mask alone tells the outline,
# and of the covered ones on black, where a dark rim's radiance does not tell


@dataclass(frozen=True)
class View:
    """One view ready for training, all in the training frame. P = pixels whose colour counts ("counting pixels").

    Attributes:
        world_to_camera: [4, 4], OpenCV axes.
        intrinsics: [3, 3], pixels.
        pixels: [P] flat indices, row by row.
        target: [P, S, 3] measured radiance in the training exposure; S = 3 Stokes components, or 1.
        colour_weight: [P] weight in the radiance and polarisation losses.
        inside: [P] bool, wholly covered by the object.
        view_direction: [P, 3] unit, from the surface to the camera.
        frame_x, frame_y: [P, 3] unit, the Stokes frame's axes (`Camera.stokes_frame`).
        alpha_target, alpha_weight: [H, W] coverage wanted, and its weight in L_mask.
        openings: share of the wholly covered pixels that look into an opening.
    """

    name: str
    split: Split
    camera: Camera
    world_to_camera: torch.Tensor
    intrinsics: torch.Tensor
    pixels: torch.Tensor
    target: torch.Tensor
    colour_weight: torch.Tensor
    inside: torch.Tensor
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

    def points_at(self, depth: torch.Tensor) -> torch.Tensor:
        """Positions [P, 3] on the counting pixels' viewing rays at depths [P] (z of the camera)."""
        rotation, translation = self.world_to_camera[:3, :3], self.world_to_camera[:3, 3]
        centre = -rotation.T @ translation
        along = -(self.view_direction @ rotation[2])  # z per unit length of the viewing ray
        return centre - self.view_direction * (depth / along)[:, None]


def thinned(view: View, chosen: torch.Tensor) -> View:
    """The view with these of its counting pixels alone (indices into them, [K])."""
    per_pixel = ("pixels", "target", "colour_weight", "inside", "view_direction", "frame_x", "frame_y")
    return replace(view, **{name: getattr(view, name)[chosen] for name in per_pixel})


def spread(count: int, wanted: int, rng: np.random.Generator) -> np.ndarray:
    """`wanted` of 0 .. count - 1, ascending: one at random out of each of as many equal stretches."""
    return np.minimum(((np.arange(wanted) + rng.random(wanted)) * (count / wanted)).astype(np.int64), count - 1)


def prepare(source: SourceView, frame: SceneFrame, black: bool, device: str = "cpu", openings: bool = False) -> View:
    """A view in the training frame, its counting pixels listed.

    Args:
        source: the view as stored.
        frame: the training frame, with its exposure.
        black: whether images are black away from the object (`background_is_black`).
        device: torch device of the tensors.
        openings: whether black pixels are openings (`has_openings`) and not dark surfaces.

    On a black background the ring about the mask counts too (its coverage is left to the model, and that of the mask's own
    edge pixels mostly); otherwise the mask's edge pixels, mixed with the background, count for nothing.
    """
    camera = frame.camera(source.camera)
    full = source.mask > COVERED
    touched = source.mask > EMPTY
    wide = grown(touched)
    core = full & ndimage.binary_erosion(full, border_value=1)
    counted = (wide if black else core) & source.valid
    at_edge = np.where(full, EDGE_WEIGHT, 0.0 if black else EDGE_WEIGHT)
    alpha_weight = np.where(core | ~(wide if black else touched), 1.0, at_edge)
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
        intrinsics=torch.as_tensor(camera.intrinsics, dtype=torch.float32),  # stays here: rasterisers read single numbers of it
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
