"""What a photograph shows of the albedo beyond a model's resolution: its log ratio to the model's own picture, high-passed.

A model of discs blurs texture below their size; the photograph does not. Photograph = body + mirror, and the albedo
multiplies the body alone, so (photograph - mirror) / body is what the model's albedo lacks, times errors of the light's model.
Those (shadows that it leaves out, a filter's transmission) are smooth or move with the view: the high-pass takes the former,
the robust mean over views the latter.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pipeline.formats.gbuffer import SurfaceImage
from pipeline.geometry.cameras import Camera
from pipeline.geometry.world import Y_UP_FROM

Image = NDArray[np.float32]
MOST = float(np.log(4.0))  # of the detail either way
LEAST_BODY = 0.02  # of the brightest body in the view: below it the ratio is noise
CUBE = 32  # texels along a face of the light's cube: the body asks for no more


class CapturedLight:
    """The light that the photographs were taken in, as training found it."""

    def __init__(self, radiance: Image, up: str, lobe: str = "ggx", fresnel: str = "exact") -> None:
        """Prefilter the light.

        Args:
            radiance: a latitude-longitude map, linear, y up. [H, W, 3]
            up: the capture's up axis.
            lobe: with which training shaded.
            fresnel: with which training shaded.
        """
        import torch

        from pipeline.shading import Prefilter, latlong

        self._turn, self._fresnel = Y_UP_FROM[up], fresnel
        self._light = Prefilter(CUBE, lobe).apply(torch.as_tensor(latlong.to_cube(radiance, CUBE), dtype=torch.float32))

    def parts(self, surface: SurfaceImage, camera: Camera) -> tuple[Image, Image]:
        """Body and mirror [H, W, 3] of a view's pixels, unshadowed; 0 where there is no surface."""
        import torch

        from pipeline.shading import shade

        height, width = surface.alpha.shape
        at = np.flatnonzero((surface.alpha > 0.5).ravel() & (np.abs(surface.normal).sum(-1) > 0.5).ravel())
        rays = camera.rays().reshape(-1, 3)[at]
        across, up = camera.stokes_axes(rays)

        def turned(v: NDArray) -> torch.Tensor:
            return torch.as_tensor(np.ascontiguousarray(v, np.float32) @ self._turn.T.astype(np.float32))

        material = torch.as_tensor(np.ascontiguousarray(surface.material.reshape(-1, 5)[at]))
        with torch.no_grad():
            shaded = shade(
                turned(surface.normal.reshape(-1, 3)[at]), turned(-rays), material[:, :3].contiguous(),
                material[:, 3].contiguous(), material[:, 4].contiguous(), turned(across), turned(up), self._light,
                fresnel=self._fresnel,
            )  # fmt: skip
        body, mirror = np.zeros((2, height * width, 3), np.float32)
        body[at], mirror[at] = np.nan_to_num(shaded.diffuse.numpy()), np.nan_to_num(shaded.specular.numpy())
        return body.reshape(height, width, 3), mirror.reshape(height, width, 3)


def photo_detail(
    photograph: Image, surface: SurfaceImage, light: CapturedLight, camera: Camera, blur_px: float
) -> tuple[Image, Image]:
    """Find what a photograph shows of the albedo beyond a model's resolution.

    Args:
        photograph: linear radiance, of the G-buffer's size. [H, W, 3]
        surface: the view's G-buffer.
        light: that it was taken in.
        camera: of the view.
        blur_px: the model's resolution, a standard deviation, pixels; coarser differences are the model's business.

    Returns:
        Log of a factor on the albedo [H, W, 3], and how far each pixel's counts, 0..1 [H, W].
    """
    from scipy.ndimage import gaussian_filter

    body, mirror = light.parts(surface, camera)
    alpha = surface.alpha[..., None]
    body, mirror = body * alpha, mirror * alpha
    bright = body.mean(-1)
    shown = (surface.alpha > 0.95) & (bright > LEAST_BODY * max(float(np.quantile(bright, 0.99)), 1e-30))
    ratio = np.clip((photograph - mirror) / np.maximum(body, 1e-30), np.exp(-2 * MOST), np.exp(2 * MOST))
    weight = np.where(shown, (bright / np.maximum(bright + mirror.mean(-1), 1e-30)) ** 2, 0).astype(np.float32)
    log = np.where(shown[..., None], np.log(ratio), 0)
    whole = gaussian_filter(weight, blur_px)
    smooth = np.stack([gaussian_filter(weight * log[..., k], blur_px) for k in range(3)], -1)
    detail = log - smooth / np.maximum(whole, 1e-6)[..., None]
    return np.clip(np.where(shown[..., None], detail, 0), -MOST, MOST).astype(np.float32), weight
