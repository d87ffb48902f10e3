"""The optimisation itself: one view a step, everything at once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import torch

from pipeline.lighting import LightField, Prefilter

from . import losses
from .data import Mode, View
from .environment import Environment
from .evaluate import psnr
from .frame import SceneFrame
from .graph import SurfaceGraph, build_graph
from .model import SplatModel
from .occlusion import ViewOcclusion
from .optimiser import Group, SurfaceAdam
from .parameters import TrainParameters
from .polarisers import AngleSums, PolariserBank, fit_angle
from .render import Rendered, render_view
from .schedule import Phase, epoch_order, phase_at

REFRESH = 100  # steps between rebuilding what depends on the geometry as a whole (graph, occlusion); checkpoints fall here
POLARISATION_SCALE = 1.0  # L_pol in encoded units weighs as much as L_rgb: both then count display steps

GROUPS = {
    "position": Group(4e-4, 6),
    "normal": Group(8e-3, 4),
    "tangent": Group(2e-3),
    "log_scale": Group(4e-3),
    "opacity": Group(2e-2),
    "albedo": Group(2e-2, 1),
    "roughness_offset": Group(4e-3, 2),
    "ior_offset": Group(2e-3, 2),
    "roughness": Group(1e-2),
    "ior": Group(1e-2),
    "environment": Group(4e-2),
    "angles": Group(4e-3),
}


@dataclass
class Scene:
    """Everything that is optimised or derived from it. `graph` and `occlusion` are rebuilt every REFRESH steps."""

    model: SplatModel
    environment: Environment
    bank: PolariserBank | None
    graph: SurfaceGraph | None = None
    occlusion: dict[tuple[str, int], ViewOcclusion] = field(default_factory=dict)


class Trainer:
    """Runs the schedule step by step. `pyramids[k]` holds every view at level k (0 = full size)."""

    def __init__(
        self,
        scene: Scene,
        pyramids: Sequence[Sequence[View]],
        mode: Mode,
        frame: SceneFrame,
        parameters: TrainParameters,
        backend: str,
    ) -> None:
        self.scene, self.mode, self.frame, self.parameters, self.backend = scene, mode, frame, parameters, backend
        self.pyramids = pyramids
        self.adam = SurfaceAdam(GROUPS)
        self.prefilter = Prefilter(parameters.environment_resolution, parameters.lobe)
        self.iteration = 0

    def tensors(self) -> dict[str, torch.Tensor]:
        """Every optimised tensor by its group's name."""
        out = dict(self.scene.model.tensors)
        out["environment"] = self.scene.environment.raw
        if self.scene.bank is not None:
            out["angles"] = self.scene.bank.angles
        return out

    def phase(self, iteration: int) -> Phase:
        """The schedule's settings at a step."""
        p = self.parameters
        return phase_at(iteration / p.iterations, p.coarse_fraction, p.consolidate_fraction)

    def view_at(self, iteration: int, phase: Phase) -> View:
        """The training view of a step: every view once an epoch, in an order that seed and epoch fix."""
        views = [v for v in self.pyramids[phase.level] if v.split == "train" or (phase.every_view and v.split == "validation")]
        epoch, place = divmod(iteration, len(views))
        return views[epoch_order(self.parameters.seed, epoch, len(views))[place]]

    def light(self) -> LightField:
        """The prefiltered environment."""
        return self.prefilter.apply(self.scene.environment.radiance())

    def refresh(self) -> None:
        """Rebuild the surface graph (and occlusion) from the current surface."""
        model = self.scene.model
        self.scene.graph = build_graph(model["position"], model["normal"])

    def step(self) -> dict[str, float]:
        """One optimisation step; returns the losses (weighted) by name."""
        if self.iteration % REFRESH == 0 or self.scene.graph is None:
            self.refresh()
        phase = self.phase(self.iteration)
        view = self.view_at(self.iteration, phase)
        rendered = self.render(view, phase.level)
        terms = self.loss_terms(view, rendered)
        total = torch.stack(list(terms.values())).sum()
        total.backward()
        self.adam.step(self.tensors(), phase.rates, self.scene.graph, phase.diffusion)
        self.iteration += 1
        return {name: float(value.detach()) for name, value in terms.items()}

    def render(self, view: View, level: int, light: LightField | None = None) -> Rendered:
        """Render a view with the current model."""
        return render_view(
            self.scene.model.activated(),
            view,
            light if light is not None else self.light(),
            backend=self.backend,
            fresnel=self.parameters.fresnel,
            occlusion=self.scene.occlusion.get((view.name, level)),
        )

    def render_whole(self, view: View) -> Rendered:
        """Render a view that is not one of the training views."""
        return self.render(view, -1)

    def skip_to_consolidation(self) -> None:
        """Go on at the last phase: every view, falling learning rates."""
        p = self.parameters
        start = int(p.iterations * (1 - p.consolidate_fraction))
        self.iteration = max(self.iteration, -(-start // REFRESH) * REFRESH)

    def measured_terms(self, view: View, rendered: Rendered) -> dict[str, torch.Tensor]:
        """Radiance and polarisation losses, as the data allow."""
        p, weight = self.parameters, view.colour_weight
        if self.mode == "polarisers" and self.scene.bank is not None:
            predicted = self.scene.bank.intensity(rendered.stokes, view.camera.name)
            return {"rgb": p.weight_rgb * losses.radiance_loss(predicted, 2 * view.target[:, 0], weight)}
        terms = {"rgb": p.weight_rgb * losses.radiance_loss(rendered.stokes[:, 0], view.target[:, 0], weight)}
        if self.mode == "stokes" and p.weight_polarisation > 0:
            scale = p.weight_polarisation * POLARISATION_SCALE
            terms["polarisation"] = scale * losses.stokes_loss(rendered.stokes, view.target, weight)
        return terms

    def loss_terms(self, view: View, rendered: Rendered) -> dict[str, torch.Tensor]:
        """All weighted losses of Eq. 10."""
        p, model, graph = self.parameters, self.scene.model, self.scene.graph
        assert graph is not None
        splats = model.activated()
        offsets = torch.stack([model["roughness_offset"], model["ior_offset"]], -1)
        terms = self.measured_terms(view, rendered)
        terms["mask"] = p.weight_mask * losses.mask_loss(
            rendered.gbuffer.alpha_image, view.alpha_target, view.alpha_weight
        )
        terms["depth_normal"] = p.weight_depth_normal * losses.depth_normal_loss(graph, splats.means, splats.normals)
        terms["smooth"] = p.weight_smooth * (
            losses.normal_smoothness(graph, splats.normals)
            + 0.2 * losses.albedo_smoothness(graph, splats.albedo)
            + losses.material_smoothness(graph, offsets)
        )
        terms["environment"] = 0.002 * p.weight_environment * self.scene.environment.roughness_of()
        return terms

    @torch.no_grad()
    def validate(self) -> float:
        """Mean sRGB PSNR (dB) inside the mask of the validation views (of the training views where none are held back)."""
        views = [v for v in self.pyramids[0] if v.split == "validation"]
        views = views or [v for v in self.pyramids[0] if v.split == "train"][:2]
        light = self.light()
        values = []
        for view in views:
            rendered = self.render(view, 0, light)
            predicted, target = rendered.stokes[:, 0], view.target[:, 0]
            if self.mode == "polarisers" and self.scene.bank is not None:
                predicted, target = self.scene.bank.intensity(rendered.stokes, view.camera.name), 2 * target
            values.append(psnr(predicted[view.inside], target[view.inside], self.frame.exposure))
        return sum(values) / len(values)

    @torch.no_grad()
    def estimate_angles(self, level: int) -> dict[str, tuple[float, float, float]]:
        """Closed-form angle, standard deviation (radians) and explained share per polariser, from all training views."""
        bank = self.scene.bank
        if bank is None:
            return {}
        light = self.light()
        sums = {name: AngleSums.empty() for name in bank.names}
        for view in self.pyramids[level]:
            if view.split == "test":
                continue
            stokes = self.render(view, level, light).stokes
            slope = losses.encode_slope(2 * view.target[:, 0].mean(-1, keepdim=True))
            weight = slope**2 * view.colour_weight[:, None]
            sums[view.camera.name].add(stokes, 2 * view.target[:, 0], weight)
        out = {}
        for k, name in enumerate(bank.names):
            fit = fit_angle(sums[name], float(bank.contrast[k]))
            out[name] = (fit.angle, fit.std, fit.explained)
        return out

    def state(self) -> dict[str, Any]:
        """Everything the next step depends on. Call it at a REFRESH boundary: graph and occlusion are rebuilt there."""
        tensors = {name: t.detach().clone() for name, t in self.tensors().items()}
        std = self.scene.bank.std_deg if self.scene.bank is not None else []
        return {"iteration": self.iteration, "tensors": tensors, "adam": self.adam.state(), "std_deg": list(std)}

    def load(self, state: dict[str, Any]) -> None:
        """Continue from a saved state."""
        tensors = dict(state["tensors"])
        with torch.no_grad():
            self.scene.environment.raw.copy_(tensors.pop("environment"))
            if self.scene.bank is not None:
                self.scene.bank.angles.copy_(tensors.pop("angles"))
                self.scene.bank.std_deg = list(state["std_deg"])
        self.scene.model = SplatModel(tensors)
        self.adam.load(state["adam"])
        self.iteration = state["iteration"]
        self.scene.graph = None
