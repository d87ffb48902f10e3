"""A view's pixels as relighting shades them: from its G-buffer, and from the mesh where that mixes surfaces."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pipeline.formats.backdrop import grown
from pipeline.formats.gbuffer import read_gbuffer
from pipeline.formats.images import read_mask
from pipeline.geometry.cameras import Camera

from .deferred import Surface
from .mesh_images import BakedMesh
from .outlines import OPAQUE, TOLD, Inner, Outlines, blended, find_outlines, interior, silhouette, without_bright_rims

LEAST_ALPHA = 1 / 255  # below it nothing shows in any display


@dataclass(frozen=True)
class ViewPixels:
    """A view's shaded pixels: where they are, how opaque, their surface, and which the mesh shows better."""

    size: tuple[int, int]  # height, width
    index: NDArray[np.int64]
    alpha: NDArray[np.float32]
    surface: Surface
    rim: NDArray[np.bool_]  # [H, W] blends of surfaces
    outlines: Outlines | None = None

    def image(self, stokes: NDArray, of_outlines: NDArray | None = None) -> NDArray[np.float32]:
        """Stokes image [H, W, 3, 3], black where there is no object, of the pixels' vectors [P, 3, 3] and the outlines'."""
        if self.outlines is not None and of_outlines is not None:
            stokes = self.outlines.replaced(stokes, of_outlines)
        out = np.zeros((self.size[0] * self.size[1], 3, 3), np.float32)
        out[self.index] = np.nan_to_num(stokes)
        shown = np.zeros(len(out), bool)
        shown[self.index] = True
        image = without_bright_rims(out.reshape(*self.size, 3, 3), self.rim, shown.reshape(self.size))
        image.reshape(-1, 3, 3)[self.index] *= self.alpha[:, None, None]
        return image


def read_view(path: Path, camera: Camera, mask: Path | None, mesh: BakedMesh | None = None) -> ViewPixels:
    """A view's G-buffer as shaded pixels; outside the mask (and the pixel beside it, half covered) there are none.

    With a mesh, the silhouette is shaded from it, and so are blends inside the mask where the mesh lies as the G-buffer does:
    it may close slots that the latter shows.
    """
    g = read_gbuffer(path)
    height, width = g.alpha.shape
    camera = camera.resized(width, height)
    shown = (g.alpha > LEAST_ALPHA) & (np.linalg.norm(g.normal, axis=-1) > 0.5)
    whole = inside = np.zeros_like(shown)
    if mask is not None and mask.exists():
        given = read_mask(mask)
        if given.shape == shown.shape:
            inside = given
            shown &= grown(inside)
            whole = interior(inside)
    index = np.flatnonzero(shown)
    rays = camera.rays()
    frame_x, frame_y = camera.stokes_frame()
    along = rays @ camera.world_to_camera[2, :3]  # z of a unit ray
    distance = g.depth / along
    position = camera.centre + rays * distance[..., None]
    images = (position, g.normal, -rays, g.material, frame_x, frame_y)
    position, normal, view, material, frame_x, frame_y = (v.reshape(-1, v.shape[-1])[index] for v in images)
    surface = Surface(position, normal, view, material, frame_x, frame_y, index)
    alpha = g.alpha.ravel()[index]
    rim = blended(g.normal)
    if mesh is None:
        return ViewPixels((height, width), index, alpha, surface, rim)
    edge = silhouette(g.alpha, whole)
    steady = shown & ~rim & (g.alpha >= OPAQUE)
    pixel = float(np.linalg.norm(rays[height // 2, width // 2] - rays[height // 2, width // 2 - 1])) if width > 1 else 1.0
    inner = Inner(inside & (rim | (g.alpha < OPAQUE)), np.where(steady, distance, np.nan), pixel)
    told = inside.ravel()[index] & (alpha >= TOLD)
    outlines = find_outlines(mesh, camera, index, edge, inner).doubting(normal, told)
    rim.ravel()[index[outlines.rows[outlines.met]]] = False
    # Mask and mesh both see the object there, whatever the splats lack.
    solid = inside.ravel()[index[outlines.rows]]
    alpha[outlines.rows] = np.maximum(alpha[outlines.rows], outlines.coverage * solid)
    return ViewPixels((height, width), index, alpha, surface, rim, outlines)
