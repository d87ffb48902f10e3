"""The scene rendered as it stands, and the self-occlusion that the renderings use, traced from it."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import torch

from pipeline.shading import LightField, Occlusion, Prefilter
from pipeline.shading.occluded import LEAST_BLOCKED

from .indirect.gridmap_or_harmonics import substitute
from .parameters import TrainParameters
from .pixel_attributes import LEAST_ALPHA
from .render_view import LEARNT_FROM, SHOWN_FROM, GBuffer, Rendered, rasterise_view, render_view
from .scene import Scene
from .splats.carried_hull import carried_hull
from .splats.gaussians import ROUGHNESS_FLOOR, Splats
from .splats.splat_occlusion import BOUNCES, lit, trace_pixels, trace_splats
from .views.view import View


class Renderer:
    """Renders a scene with one shading model. Occlusion is a constant of the shading from one tracing to the next.

    Args:
        scene: what is rendered; `trace` writes its occlusion there.
        parameters: shading model, environment resolution and seed.
        backend: rasteriser, "cpu", "cuda" or "reference".
    """

    def __init__(self, scene: Scene, parameters: TrainParameters, backend: str) -> None:
        self.scene, self.parameters, self.backend = scene, parameters, backend
        self.prefilter = Prefilter(parameters.environment_resolution, parameters.lobe)
        self.substitute = substitute(scene, parameters)  # of traced light
        self.bounces = BOUNCES

    def light(self) -> LightField:
        """The prefiltered environment."""
        return self.prefilter.apply(self.scene.environment.radiance())

    def render(self, view: View, level: int, light: LightField | None = None) -> Rendered:
        """A training view at a pyramid level, with the occlusion traced for it last. `light` saves prefiltering again."""
        return self.render_under(view, self.scene.occlusion.get((view.name, level)), light)

    def render_under(self, view: View, occlusion: Occlusion | None, light: LightField | None = None) -> Rendered:
        """A view with the occlusion of its counting pixels given."""
        light = light if light is not None else self.light()
        return self._shaded(self.scene.model.activated(), view, light, occlusion)

    def render_whole(self, view: View) -> Rendered:
        """Any view as it is written, traced for itself where the object occludes itself."""
        light, splats = self.light(), self.scene.model.activated()
        if self.substitute is not None:
            other = self.substitute
            return self._shaded(splats, view, light, (lambda g: other.at(view, g)) if other.active else None, SHOWN_FROM)
        traced = self.scene.splat_occlusion is not None
        occlusion = self.trace_view(view, light, splats, SHOWN_FROM) if traced else None
        return self._shaded(splats, view, light, occlusion, SHOWN_FROM)

    def _shaded(
        self,
        splats: Splats,
        view: View,
        light: LightField,
        occlusion: Occlusion | Callable[[GBuffer], Occlusion] | None,
        faintest: float = LEARNT_FROM,
    ) -> Rendered:
        p = self.parameters
        extra = self.substitute.extra(view, splats) if self.substitute is not None and occlusion is not None else None
        return render_view(
            splats, view, light, backend=self.backend, fresnel=p.fresnel, mirror=p.mirror, occlusion=occlusion, extra=extra,
            faintest=faintest,
        )  # fmt: skip

    @torch.no_grad()
    def trace(self, views: Sequence[View], level: int) -> None:
        """Trace shadows, bounces and blocked reflections (or what `train.indirect` puts in their place) for every one of the
        views, which are those of a pyramid level."""
        light, splats = self.light(), self.scene.model.activated()
        self.trace_surface(light, splats)
        self.scene.occlusion.clear()
        if self.substitute is not None and self.substitute.active:
            for view in views:
                seen = rasterise_view(splats, view, view.pixels, self.backend)
                self.scene.occlusion[view.name, level] = self.substitute.at(view, seen, follows=True)
        if self.scene.splat_occlusion is None:
            return
        for view in views:
            self.scene.occlusion[view.name, level] = self.trace_view(view, light, splats)

    def trace_surface(self, light: LightField, splats: Splats) -> None:
        """The occluder and what each splat receives; None of the latter where little is occluded, or nothing is traced."""
        scene, p = self.scene, self.parameters
        scene.occluder = carried_hull(scene.hull, scene.model)
        if self.substitute is not None:
            self.substitute.update(light, splats)
            return
        traced = trace_splats(scene.occluder, splats, light, scene.linked(), p.seed, p.fresnel, self.bounces)
        scene.splat_occlusion = traced if traced.blocked >= LEAST_BLOCKED else None

    @torch.no_grad()
    def trace_view(self, view: View, light: LightField, splats: Splats, faintest: float = LEARNT_FROM) -> Occlusion:
        """Occlusion at a view's pixels: shadow and bounce blended from the splats, the reflection lobe traced."""
        traced, occluder = self.scene.splat_occlusion, self.scene.occluder
        assert traced is not None and occluder is not None
        extra = torch.cat([traced.shadow, traced.bounced], -1)
        g = rasterise_view(splats, view, view.pixels, self.backend, extra, faintest)
        shadow, bounced = g.extra[:, :3], g.extra[:, 3:]
        unblocked, seen = torch.ones_like(g.alpha), torch.zeros_like(bounced)
        # Where not one of the rays of the splats and of their neighbours met the object, the mirrored ones do not either.
        rows = torch.nonzero((bounced > 0).any(-1))[:, 0]
        if not len(rows):
            return Occlusion(shadow=shadow, bounced=bounced, unblocked=unblocked, seen=seen)
        depth = g.raster.depth_expected.reshape(-1)[view.pixels] / g.alpha.clamp_min(LEAST_ALPHA)
        normal = torch.where(g.alpha[:, None] > 0, g.normal, view.view_direction)
        unblocked[rows], seen[rows] = trace_pixels(
            occluder,
            splats,
            light,
            view.points_at(depth)[rows].cpu().numpy(),
            normal[rows].cpu().numpy(),
            view.view_direction[rows].cpu().numpy(),
            g.roughness[rows].clamp(ROUGHNESS_FLOOR, 1).cpu().numpy(),
            self.scene.linked().spacing,
            self.parameters.seed,
            self.parameters.fresnel,
            lit(traced, self.bounces),
        )
        return Occlusion(shadow=shadow, bounced=bounced, unblocked=unblocked, seen=seen)
