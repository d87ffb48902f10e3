"""The two substitutes for traced light while training, each made anew from the scene every `every` steps."""

from __future__ import annotations

import numpy as np
import torch

from pipeline.geometry.occluder import Occluder
from pipeline.shading import LightField, Occlusion
from pipeline.shading.gridmap import GridMap, nearest_albedo
from pipeline.shading.occluded import LEAST_BLOCKED, blocked_share

from ..parameters import TrainParameters
from ..render_view import GBuffer
from ..scene import Scene
from ..splats.gaussians import ROUGHNESS_FLOOR, Splats
from ..splats.splat_occlusion import LIFT
from ..views.view import View
from .harmonics import towards_mirror
from .mirrored_rays import MirroredRays, everywhere, shown_surface
from .pixel_light import GridLight, LearntLight

GRIDMAP_EVERY = 300  # steps between two of them (PhyGaP 9.4)


class Substitute:
    """Indirect light from something else than rays at every splat.

    `active`: whether the object hides anything from itself; where it does not, this is left out.
    """

    def __init__(self, scene: Scene, parameters: TrainParameters) -> None:
        self.scene, self.parameters = scene, parameters
        self.active = False

    @torch.no_grad()
    def update(self, light: LightField, splats: Splats) -> None:
        """Take the scene as it is; its occluder has been carried along already."""
        hull = self.scene.occluder
        assert hull is not None
        occluder = Occluder(hull.vertices, hull.triangles, hull.normals)
        self.active = blocked_share(occluder) >= LEAST_BLOCKED
        if self.active:
            self.mirrors = MirroredRays(hull, LIFT * self.scene.linked().spacing, self.parameters.seed)
            self.prepare(occluder, light, splats)

    def prepare(self, occluder: Occluder, light: LightField, splats: Splats) -> None:
        """What `at` needs of the scene."""

    def extra(self, view: View, splats: Splats) -> torch.Tensor | None:
        """Values of every splat [N, C] to blend alongside, with their gradient."""
        return None

    def at(self, view: View, gbuffer: GBuffer, follows: bool = False) -> Occlusion:
        """The light at a view's pixels, of which the G-buffer is the rendering as it is; no gradient.

        follows: for the steps of training to come too.
        """
        raise NotImplementedError


class LocalEnvironments(Substitute):
    """PhyGaP's GridMap of the hull, lit by the environment as it is, with the albedo of the nearest splats."""

    def prepare(self, occluder: Occluder, light: LightField, splats: Splats) -> None:
        """Cast the anchors' rays and prefilter what they see."""
        p = self.parameters
        albedo = nearest_albedo(splats.means.cpu().numpy(), splats.albedo.cpu().numpy(), occluder.vertices)
        self.grid = GridMap(
            occluder, albedo, weights=p.gridmap_weights, anchors=p.gridmap_anchors, lobe=p.lobe, fresnel=p.fresnel
        )  # fmt: skip
        self.light = self.grid.light(self.scene.environment.radiance(), light)

    @torch.no_grad()
    def at(self, view: View, gbuffer: GBuffer, follows: bool = False) -> Occlusion:
        """Look the anchors up at a view's pixels."""
        at, alpha = shown_surface(view, gbuffer), gbuffer.alpha
        roughness = gbuffer.roughness.detach().clamp(ROUGHNESS_FLOOR, 1).cpu().numpy()[at.rows]
        blocked = self.mirrors.blocked(at)
        mirrored = self.grid.mirrored(at.points, at.mirrored, roughness, np.flatnonzero(blocked), self.light)
        unblocked, seen = everywhere(~blocked, at.rows, alpha), everywhere(mirrored, at.rows, alpha)
        shadow = torch.zeros_like(seen)  # all light comes from the anchors
        if not follows:
            received = self.grid.received(at.points, at.normals, self.light)
            return Occlusion(shadow, everywhere(received, at.rows, alpha), unblocked, seen)
        found = (*self.grid.received_and_slope(at.points, at.normals, self.light), at.normals)
        bounced, slope, normal = (everywhere(values, at.rows, alpha) for values in found)
        return GridLight(shadow, bounced, unblocked, seen, normal, slope)


class LearntHarmonics(Substitute):
    """Ref-Gaussian's: mirrored light that the object blocks is what every Gaussian has learnt; diffuse light goes free."""

    def extra(self, view: View, splats: Splats) -> torch.Tensor | None:
        """The learnt radiance of every splat [N, 3]."""
        return towards_mirror(self.scene.model, splats, view)

    @torch.no_grad()
    def at(self, view: View, gbuffer: GBuffer, follows: bool = False) -> Occlusion:
        """Which pixels mirror the object."""
        at = shown_surface(view, gbuffer)
        unblocked = 1 - everywhere(self.mirrors.blocked(at), at.rows, gbuffer.alpha)
        ones, zeros = (torch.full((len(unblocked), 3), v, device=unblocked.device) for v in (1.0, 0.0))
        return LearntLight(ones, zeros, unblocked, zeros)


def substitute(scene: Scene, parameters: TrainParameters) -> Substitute | None:
    """What `train.indirect` puts in the place of traced light; None for "traced" and "none"."""
    kinds: dict[str, type[Substitute]] = {"gridmap": LocalEnvironments, "sh": LearntHarmonics}
    return kinds[parameters.indirect](scene, parameters) if parameters.indirect in kinds else None
