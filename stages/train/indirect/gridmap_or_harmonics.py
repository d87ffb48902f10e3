"""The two substitutes for traced light while training, each made anew from the scene every `every` steps."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch

from pipeline.geometry.occluder import Occluder
from pipeline.shading import LightField, Occlusion
from pipeline.shading.gridmap import GridMap, nearest_albedo
from pipeline.shading.occluded import LEAST_BLOCKED, blocked_share

from ..parameters import TrainParameters
from ..pixel_attributes import LEAST_ALPHA
from ..render_view import GBuffer
from ..scene import Scene
from ..splats.gaussians import ROUGHNESS_FLOOR, Splats
from ..splats.splat_occlusion import LIFT, CarriedHull
from ..views.view import View
from .harmonics import towards_mirror
from .pixel_light import GridLight, LearntLight

GRIDMAP_EVERY = 300  # steps between two of them (PhyGaP 9.4)
TILT = 0.05  # of a normal, by which the irradiance's slope is taken: half a texel of the diffuse level


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
        rows, points, normals, towards = shown_surface(view, gbuffer)
        roughness = gbuffer.roughness[rows].clamp(ROUGHNESS_FLOOR, 1).cpu().numpy()
        weight, blocked = self.grid.blend(points), mirror_blocked(self.scene, points, normals, towards)
        found = self.grid.occlusion(points, normals, towards, roughness, self.light, blocked, weight)

        def everywhere(values: torch.Tensor) -> torch.Tensor:
            out = torch.zeros(len(gbuffer.alpha), *values.shape[1:], device=rows.device)
            return out.index_copy_(0, rows, values.to(rows.device))

        bounced, unblocked, seen = (everywhere(x) for x in (found.bounced, found.unblocked, found.seen))
        shadow = torch.zeros_like(bounced)  # all light comes from the anchors
        if not follows:
            return Occlusion(shadow, bounced, unblocked, seen)
        slope = everywhere(torch.as_tensor(self._slope(weight, normals, found.bounced.numpy())))
        return GridLight(shadow, bounced, unblocked, seen, everywhere(torch.as_tensor(normals)), slope)

    def _slope(self, weight: np.ndarray, normal: np.ndarray, here: np.ndarray) -> np.ndarray:
        """Change [P, 3, 3] of the irradiance with the normal, across it; weight [P, A]: of the anchors."""
        slope = np.zeros((len(normal), 3, 3), np.float32)
        helper = np.eye(3, dtype=np.float32)[np.abs(normal).argmin(-1)]
        first = np.cross(helper, normal)
        first /= np.maximum(np.linalg.norm(first, axis=-1, keepdims=True), 1e-12)
        for axis in (first, np.cross(normal, first)):
            there = self.grid.received(weight, normal + TILT * axis, self.light)
            slope += axis[:, :, None] * ((there - here) / TILT)[:, None]
        return slope


class LearntHarmonics(Substitute):
    """Ref-Gaussian's: mirrored light that the object blocks is what every Gaussian has learnt; diffuse light goes free."""

    def extra(self, view: View, splats: Splats) -> torch.Tensor | None:
        """The learnt radiance of every splat [N, 3]."""
        return towards_mirror(self.scene.model, splats, view)

    @torch.no_grad()
    def at(self, view: View, gbuffer: GBuffer, follows: bool = False) -> Occlusion:
        """Which pixels mirror the object."""
        rows, *surface = shown_surface(view, gbuffer)
        unblocked = torch.ones(len(gbuffer.alpha), device=rows.device)
        unblocked[rows[torch.as_tensor(mirror_blocked(self.scene, *surface), device=rows.device)]] = 0
        ones, zeros = (torch.full((len(unblocked), 3), v, device=unblocked.device) for v in (1.0, 0.0))
        return LearntLight(ones, zeros, unblocked, zeros)


def substitute(scene: Scene, parameters: TrainParameters) -> Substitute | None:
    """What `train.indirect` puts in the place of traced light; None for "traced" and "none"."""
    kinds: dict[str, type[Substitute]] = {"gridmap": LocalEnvironments, "sh": LearntHarmonics}
    return kinds[parameters.indirect](scene, parameters) if parameters.indirect in kinds else None


def shown_surface(view: View, gbuffer: GBuffer) -> tuple[torch.Tensor, np.ndarray, np.ndarray, np.ndarray]:
    """Which of a view's pixels show the object [K], and their positions, normals and directions to the camera [K, 3]."""
    rows = torch.nonzero(gbuffer.alpha.detach() > LEAST_ALPHA)[:, 0]
    small = replace(view, view_direction=view.view_direction[rows])
    depth = gbuffer.raster.depth_expected.detach().reshape(-1)[view.pixels[rows]] / gbuffer.alpha.detach()[rows]
    tensors = (small.points_at(depth), gbuffer.normal.detach()[rows], small.view_direction)
    points, normals, towards = (t.cpu().numpy() for t in tensors)
    return rows, points, normals, towards


def mirror_blocked(scene: Scene, points: np.ndarray, normals: np.ndarray, towards: np.ndarray) -> np.ndarray:
    """Whether each point's mirror ray meets the object [P]: "invisible", as Ref-Gaussian and PhyGaP call it."""
    hull: CarriedHull | None = scene.occluder
    assert hull is not None
    mirrored = 2 * np.einsum("pk,pk->p", normals, towards)[:, None] * normals - towards
    origins = points + LIFT * scene.linked().spacing * normals
    met = hull.rays.blocked(origins, mirrored)  # by whichever side: cheap
    rows = np.flatnonzero(met)
    met[rows], _ = hull.cast(origins[rows], mirrored[rows])
    return met
