"""What a substitute for traced light gives a view's pixels: an `Occlusion` that follows what is rendered from step to step."""

from __future__ import annotations

from dataclasses import dataclass

import torch

from pipeline.shading import Occlusion


@dataclass(frozen=True)
class PixelLight(Occlusion):
    """Constants as an `Occlusion` has them, and how a rendering of the same pixels changes them."""

    def under(self, normal: torch.Tensor, extra: torch.Tensor) -> Occlusion:
        """The light for a rendering with these normals [P, 3], and values [P, C] blended from the splats."""
        raise NotImplementedError


@dataclass(frozen=True)
class GridLight(PixelLight):
    """GridMap's: the irradiance follows the normal in first order, so that shading still turns normals, and nothing else.

    normal [P, 3]: where it was looked up; slope [P, 3 (of the normal), 3 (rgb)]: its change with it.
    """

    normal: torch.Tensor
    slope: torch.Tensor

    def under(self, normal: torch.Tensor, extra: torch.Tensor) -> Occlusion:
        """The light for a rendering with these normals [P, 3], and values [P, C] blended from the splats."""
        bounced = self.bounced + ((normal - self.normal)[:, :, None] * self.slope).sum(1)  # einsum: a matrix product a pixel
        return Occlusion(self.shadow, bounced.clamp_min(0), self.unblocked, self.seen)


@dataclass(frozen=True)
class LearntLight(PixelLight):
    """Ref-Gaussian's: where the mirror ray is blocked, the radiance that was blended from the Gaussians as `extra`."""

    def under(self, normal: torch.Tensor, extra: torch.Tensor) -> Occlusion:
        """The light for a rendering with these normals [P, 3], and values [P, C] blended from the splats."""
        return Occlusion(self.shadow, self.bounced, self.unblocked, (1 - self.unblocked)[:, None] * extra)
