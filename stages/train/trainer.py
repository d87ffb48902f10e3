"""One step of the optimisation: one view, everything at once (`training_loop` repeats it)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import torch

from pipeline.shading import Occlusion

from .evaluate import validation_psnr
from .indirect.trust import trusted
from .material_groups import OFFSETS, GroupStep
from .objective import loss_terms
from .olat_priors import OlatPriors
from .parameters import TrainParameters
from .render_view import Rendered
from .renderer import Renderer
from .scene import Scene
from .schedule import Phase, epoch_order, phase_at, step_rules
from .splats.albedo_light_scale import ScaleStep
from .splats.optimiser import SurfaceAdam
from .upkeep import LATE_FROM, Upkeep
from .views.angle_fit import AngleFit, fit_angles
from .views.source_views import Mode
from .views.training_frame import SceneFrame
from .views.view import View, spread, thinned

ANGLE_STEPS = (200, 300)  # steps at which unknown polariser angles are solved for outright; descent does the rest


class Trainer:
    """Runs the schedule step by step.

    Args:
        scene: what is optimised, in place.
        pyramids: `pyramids[k]` holds every training and validation view at level k (0 = full size).
        mode: what the views hold: full Stokes, intensities behind polarisers, or plain radiance.
        frame: the training frame, for its exposure.
        parameters: the stage's.
        backend: rasteriser, "cpu", "cuda" or "reference".
        priors: what a light stage has measured of the same object; None: nothing.
    """

    def __init__(
        self,
        scene: Scene,
        pyramids: Sequence[Sequence[View]],
        mode: Mode,
        frame: SceneFrame,
        parameters: TrainParameters,
        backend: str,
        priors: OlatPriors | None = None,
    ) -> None:
        parameters = replace(parameters, iterations=parameters.steps(mode))
        self.scene, self.mode, self.frame, self.parameters = scene, mode, frame, parameters
        self.pyramids, self.priors = pyramids, priors
        self.adam = SurfaceAdam(step_rules(mode))
        self.scale_step = ScaleStep()
        self.group_step = GroupStep()
        self.renderer = Renderer(scene, parameters, backend)
        if mode != "stokes":
            self.renderer.bounces = 1  # a third of the numbers does not bear more: roughness takes up what a second bounce adds
        self.upkeep = Upkeep(scene, self.adam, self.renderer, pyramids[0], mode, parameters)
        self.iteration = 0

    def step(self) -> dict[str, float]:
        """One optimisation step; returns the losses (weighted) by name."""
        phase = self.phase(self.iteration)
        if self.upkeep.due(self.iteration, phase.level):
            self.upkeep.refresh(self.iteration, self.pyramids[phase.level], phase.level)
        self.group_splats()
        if self.iteration in ANGLE_STEPS and phase.level == 0:
            self.set_unknown_angles(phase.level)
        view, occlusion = self.looked_at(self.view_at(self.iteration, phase), phase)
        if self.mode == "stokes":
            view = trusted(view, occlusion, self.iteration / self.parameters.iterations)
        rendered = self.renderer.render_under(view, occlusion)
        terms, surface_parts = loss_terms(self.weights(phase), self.mode, self.scene, view, rendered)
        if self.priors is not None:
            terms |= self.priors.terms(rendered.splats, self.iteration)
        torch.stack(list(terms.values())).sum().backward()
        self.update(rendered, phase)
        self.iteration += 1
        told = {name: value.detach() for name, value in terms.items() if name != "surface"} | surface_parts
        return dict(zip(told, torch.stack([value.double() for value in told.values()]).tolist()))  # a GPU is waited for once

    def group_splats(self) -> None:
        """Look for colours anew where the splats are others, and as often as the state is saved."""
        if self.mode != "stokes" or self.iteration < LATE_FROM:
            return  # a third of the numbers is not evidence enough; before, albedo means nothing yet
        groups = self.scene.groups
        if self.iteration % self.upkeep.period == 0 or (groups is not None and len(groups.of) != len(self.scene.model)):
            self.scene.regroup()

    def update(self, rendered: Rendered, phase: Phase) -> None:
        """Move everything along the gradients that a rendering's loss has left."""
        raster, scene = rendered.gbuffer.raster, self.scene
        self.upkeep.activity.add(rendered.gbuffer.rows, raster.screen_gradient, raster.visible)
        if self.parameters.environment_activation == "exponential":
            self.scale_step.step(scene.environment.raw, scene.model["albedo"], phase.rates[""])
        if scene.groups is not None:
            rules = (self.adam.rules[name.removesuffix("_offset")] for name in OFFSETS)  # as fast as what all splats share
            self.group_step.step(scene.model, scene.groups, tuple(phase.rates[""] * rule.rate for rule in rules))
        self.adam.step(scene.tensors(), phase.rates, scene.graph, phase.diffusion)

    def phase(self, iteration: int) -> Phase:
        """The schedule's settings at a step."""
        p = self.parameters
        coarse = p.coarse_fraction if len(self.pyramids) > 1 else 0.0
        return phase_at(iteration / p.iterations, coarse, p.consolidate_fraction)

    def weights(self, phase: Phase) -> TrainParameters:
        """The parameters with the weights of a phase; the printed losses' stay as they are."""
        p = self.parameters
        return p if p.losses == "printed" else replace(p, weight_depth_normal=phase.agreement * p.weight_depth_normal)

    def view_at(self, iteration: int, phase: Phase) -> View:
        """The training view of a step: every view once an epoch, in an order that seed and epoch fix."""
        views = [v for v in self.pyramids[phase.level] if v.split == "train" or (phase.every_view and v.split == "validation")]
        epoch, place = divmod(iteration, len(views))
        return views[epoch_order(self.parameters.seed, epoch, len(views))[place]]

    def looked_at(self, view: View, phase: Phase) -> tuple[View, Occlusion | None]:
        """A step's view and its occlusion: with `pixels_per_splat`, that many of its pixels for each splat in it.

        They are spread evenly, and others at each step. The last phase sees all.
        """
        p, occlusion = self.parameters, self.scene.occlusion.get((view.name, phase.level))
        wanted = round(p.pixels_per_splat * len(self.scene.model) / 2)  # half of a closed surface turns away
        images = p.losses != "encoded" or p.weight_dssim > 0  # these losses compare neighbouring pixels
        if (
            not wanted
            or phase.every_view
            or images
            or wanted >= len(view.pixels)
            or not isinstance(occlusion, Occlusion | None)
        ):
            return view, occlusion
        rng = np.random.default_rng([p.seed, 1, self.iteration])
        chosen = torch.as_tensor(spread(len(view.pixels), wanted, rng), device=view.pixels.device)
        if occlusion is not None:
            parts = (occlusion.shadow, occlusion.bounced, occlusion.unblocked, occlusion.seen)
            occlusion = Occlusion(*(t[chosen] for t in parts))
        return thinned(view, chosen), occlusion

    def skip_to_consolidation(self) -> None:
        """Go on at the last phase: every view, falling learning rates."""
        p = self.parameters
        start = int(p.iterations * (1 - p.consolidate_fraction))
        self.iteration = max(self.iteration, start // self.upkeep.period * self.upkeep.period)

    @torch.no_grad()
    def validate(self) -> float:
        """Mean sRGB PSNR (dB) inside the mask of the validation views (of two training views where none are held back)."""
        return validation_psnr(self.renderer, self.pyramids[0], self.mode, self.frame.exposure)

    @torch.no_grad()
    def estimate_angles(self, level: int) -> dict[str, AngleFit]:
        """Closed-form angle of every polariser, from all training views."""
        bank = self.scene.bank
        if bank is None:
            return {}
        light = self.renderer.light()
        seen = [v for v in self.pyramids[level] if v.split != "test"]
        return fit_angles(bank, ((view, self.renderer.render(view, level, light).stokes) for view in seen))

    def set_unknown_angles(self, level: int) -> None:
        """Put the closed-form angles in; a known angle is nearer than a half-trained model's estimate."""
        bank = self.scene.bank
        for name, fit in self.estimate_angles(level).items():
            assert bank is not None
            if not bank.known[bank.names.index(name)]:
                bank.set_angle(name, fit.angle)

    def state(self) -> dict[str, Any]:
        """Everything the next step depends on. Call it at a multiple of `Upkeep.period`: what is derived is rebuilt there."""
        return {
            "iteration": self.iteration,
            "scene": self.scene.state(),
            "adam": self.adam.state(),
            "scale_step": self.scale_step.state(),
            "group_step": self.group_step.state(),
            **({} if self.priors is None else {"priors": self.priors.state()}),
            **self.upkeep.state(),
        }

    def load(self, state: dict[str, Any]) -> None:
        """Continue from a saved state."""
        self.scene.load(state["scene"])
        self.adam.load(state["adam"])
        self.scale_step.load(state["scale_step"])
        self.group_step.load(state["group_step"])
        if self.priors is not None:
            self.priors.load(state["priors"])
        self.upkeep.load(state)
        self.iteration = state["iteration"]
