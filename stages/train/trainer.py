"""The optimisation itself: one view a step, everything at once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import torch

from pipeline.shading import LightField, Occlusion, Prefilter

from .evaluate import psnr
from .initialise.hull import HullMesh
from .log_environment import Environment
from .parameters import TrainParameters
from .render_view import LEAST_ALPHA, Rendered, rasterise_view, render_view
from .schedule import Phase, epoch_order, phase_at
from .splats.albedo_light_scale import Exchange
from .splats.densify import Activity, edges_to_split, keep, kept_rows, split_edges
from .splats.gaussians import SplatModel, Splats
from .splats.optimiser import Group, SurfaceAdam
from .splats.splat_occlusion import (
    LEAST_BLOCKED,
    Occluder,
    SplatOcclusion,
    carried_hull,
    trace_pixels,
    trace_splats,
    view_occlusion,
)
from .splats.surface_graph import SurfaceGraph, build_graph
from .splats.surface_losses import SurfaceWeights, surface_loss
from .views import losses
from .views.data import Mode, View
from .views.dssim import dssim
from .views.polarisers import AngleFit, AngleSums, PolariserBank, fit_views
from .views.training_frame import SceneFrame

REFRESH = 100  # steps between rebuilding the surface graph
CYCLE = 2 * REFRESH  # steps between densification, tracing and checkpoints: nothing traced has to be saved then
RECESS_AT = (400, 600, 800)  # steps, multiples of CYCLE, before which hollows are looked for: the light must be about right
LEAST_CONCAVITY = 0.03  # share of the surface below which what is found counts as noise, and is not looked for again: a
# teapot's reflections in itself fake up to 0.019, real webs were 0.075 and more
OCCLUSION_FROM = 200  # steps before the first tracing: the light and the albedo must mean something
RECESS_UNTIL = 0.6  # share of the run after which there is no time left to settle
DENSIFY_UNTIL = 0.6  # share of the run after which the splats stay as they are
ANGLE_STEPS = (200, 300)  # steps at which unknown polariser angles are solved for outright; descent does the rest
POLARISATION_SCALE = 1.0  # L_pol in encoded units weighs as much as L_rgb: both then count display steps

GROUPS = {
    "position": Group(4e-4, 6),
    "normal": Group(8e-3, 4),
    "log_scale": Group(4e-3),
    "opacity": Group(2e-2),
    "albedo": Group(2e-2, 1),
    "roughness_offset": Group(4e-3, 2),
    "ior_offset": Group(2e-3, 2),
    "roughness": Group(1e-2),
    "ior": Group(1e-2),
    "environment": Group(4e-2),
    "angles": Group(2e-2),
}


@dataclass
class Scene:
    """Everything that is optimised or derived from it. `graph` and `occlusion` are rebuilt as training goes."""

    model: SplatModel
    environment: Environment
    bank: PolariserBank | None
    hull: HullMesh  # training frame; open where openings were cut
    closed: HullMesh | None = None  # the same without cuts, where there are any
    graph: SurfaceGraph | None = None
    occlusion: dict[tuple[str, int], Occlusion] = field(default_factory=dict)


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
        self.exchange = Exchange()
        self.prefilter = Prefilter(parameters.environment_resolution, parameters.lobe)
        self.iteration = 0
        self.activity = Activity.empty(len(scene.model), scene.model["position"].device)
        self.surface_parts: dict[str, float] = {}
        self.occluder: Occluder | None = None
        self.surface_occlusion: SplatOcclusion | None = None
        self.blocked = 0.0
        self.hollowed: list[float] = []  # share of the surface that was found to lie deeper, by search

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
        """Rebuild the surface graph from the current surface and, when it is due, what the object hides from itself."""
        model = self.scene.model
        self.scene.graph = build_graph(model["position"], model["normal"])
        if self.iteration % CYCLE:
            return
        if self.iteration > 0 and self.densify():
            self.scene.graph = build_graph(model["position"], model["normal"])
        traces = self.parameters.occlusion and self.iteration >= OCCLUSION_FROM
        if traces:
            self.trace()
        if self.looks_for_concavities() and self.concavity() and traces:
            self.trace()

    def looks_for_concavities(self) -> bool:
        """Whether a search is due: the data can tell, there is time to settle, and the last search was not in vain."""
        p = self.parameters
        due = self.iteration in RECESS_AT and self.iteration <= RECESS_UNTIL * p.iterations
        return p.searches_concavities(self.mode) and due and (not self.hollowed or self.hollowed[-1] >= LEAST_CONCAVITY)

    def densify(self) -> bool:
        """Remove what does not show, then add where the images pull hardest, up to the bound; whether it is still time."""
        p, model = self.parameters, self.scene.model
        done = self.iteration / p.iterations
        if p.densify and done <= DENSIFY_UNTIL:
            backs = any(view.openings > 0 for view in self.pyramids[0])
            rows = kept_rows(torch.sigmoid(model["opacity"].detach()), self.activity, backs)
            if len(rows) < len(model) and len(rows) > len(model) // 2:
                keep(model, self.adam, rows)
                self.activity = Activity(*(getattr(self.activity, name)[rows] for name in vars(self.activity)))
                self.scene.graph = build_graph(model["position"], model["normal"])
            assert self.scene.graph is not None
            split_edges(model, self.adam, edges_to_split(self.scene.graph, self.activity, p.max_splats - len(model)))
        self.activity = Activity.empty(len(model), model["position"].device)
        return p.densify and done <= DENSIFY_UNTIL

    @torch.no_grad()
    def concavity(self) -> bool:
        """Look for hollows that no silhouette shows, and move the surface into them; whether any splat made way.

        The splats elsewhere stay. What the object hides from itself must have been traced on the surface as it is.
        """
        from .concavity.explanation import shading_tables
        from .concavity.hollow import DepthField, hollowed
        from .concavity.refit import refit
        from .concavity.samples import view_images
        from .concavity.search import surface_depths

        model, p, graph = self.scene.model, self.parameters, self.scene.graph
        assert graph is not None
        surface = self._carried(self.scene.hull)
        occlusion = {name: traced for (name, level), traced in self.scene.occlusion.items() if level == 0}
        images = view_images(self.pyramids[0], self.mode, self.scene.bank, occlusion)
        splats = model.activated()
        shading = shading_tables(splats, self.light(), p.fresnel)
        points, albedo = splats.means.detach().cpu().numpy(), splats.albedo.detach().cpu().numpy()
        found = surface_depths(surface, images, shading, points, albedo, p.seed)
        self.hollowed.append(found.share)
        if found.share < LEAST_CONCAVITY:
            return False
        field = DepthField(found.points, found.depths)
        hollow = hollowed(surface if self.scene.closed is None else self._carried(self.scene.closed), field)
        if hollow is None or refit(model, self.adam, field, hollow, graph.spacing, p.max_splats, p.seed) is None:
            return False
        self.scene.hull, self.scene.closed = hollow, None
        self.scene.graph = build_graph(model["position"], model["normal"])
        self.activity = Activity.empty(len(model), model["position"].device)
        return True

    def _carried(self, hull: HullMesh) -> HullMesh:
        """The hull as the splats have moved it."""
        carried = carried_hull(hull, self.scene.model)
        return HullMesh(carried.vertices, carried.triangles, carried.normals)

    @torch.no_grad()
    def trace(self) -> None:
        """Trace shadows, bounces and blocked reflections for every training view at the level in use."""
        light, splats = self.light(), self.scene.model.activated()
        self.trace_surface(light, splats)
        self.scene.occlusion.clear()
        if self.surface_occlusion is None:
            return
        level = self.phase(self.iteration).level
        for view in self.pyramids[level]:
            self.scene.occlusion[view.name, level] = self.trace_view(view, light, splats)

    def trace_surface(self, light: LightField, splats: Splats) -> None:
        """The occluder and what each splat receives; None where nothing is occluded."""
        assert self.scene.graph is not None
        self.occluder = carried_hull(self.scene.hull, self.scene.model)
        fresnel = self.parameters.fresnel
        traced = trace_splats(self.occluder, splats, light, self.scene.graph, self.parameters.seed, fresnel)
        self.blocked = traced.blocked
        self.surface_occlusion = traced if traced.blocked >= LEAST_BLOCKED else None

    @torch.no_grad()
    def trace_view(self, view: View, light: LightField, splats: Splats) -> Occlusion:
        """Occlusion at a view's pixels: shadow and bounce blended from the splats, the reflection lobe traced."""
        traced, graph = self.surface_occlusion, self.scene.graph
        assert traced is not None and graph is not None and self.occluder is not None
        extra = torch.cat([traced.shadow, traced.bounced], -1)
        g = rasterise_view(splats, view, view.pixels, self.backend, extra)
        alpha = g.alpha.clamp_min(LEAST_ALPHA)
        depth = g.raster.depth_expected.reshape(-1)[view.pixels] / alpha
        rotation, translation = view.world_to_camera[:3, :3], view.world_to_camera[:3, 3]
        centre = -rotation.T @ translation
        along = -(view.view_direction @ rotation[2])  # z per unit length of the viewing ray
        points = centre - view.view_direction * (depth / along)[:, None]
        normal = torch.where(g.alpha[:, None] > 0, g.normal, view.view_direction)
        unblocked, seen = trace_pixels(
            self.occluder,
            splats,
            light,
            points.cpu().numpy(),
            normal.cpu().numpy(),
            view.view_direction.cpu().numpy(),
            g.roughness.clamp(0.08, 1).cpu().numpy(),
            graph.spacing,
            self.parameters.seed,
            self.parameters.fresnel,
        )
        return view_occlusion(g.extra[:, :3], g.extra[:, 3:], unblocked, seen)

    def step(self) -> dict[str, float]:
        """One optimisation step; returns the losses (weighted) by name."""
        if self.iteration % REFRESH == 0 or self.scene.graph is None:
            self.refresh()
        phase = self.phase(self.iteration)
        if self.scene.bank is not None and self.iteration in ANGLE_STEPS and phase.level == 0:
            known = dict(zip(self.scene.bank.names, self.scene.bank.known))
            for name, fit in self.estimate_angles(phase.level).items():
                if not known[name]:  # a told angle is nearer than a half-trained model's estimate
                    self.scene.bank.set_angle(name, fit.angle)
        view = self.view_at(self.iteration, phase)
        rendered = self.render(view, phase.level)
        terms = self.loss_terms(view, rendered)
        total = torch.stack(list(terms.values())).sum()
        total.backward()
        raster = rendered.gbuffer.raster
        self.activity.add(rendered.gbuffer.rows, raster.screen_gradient, raster.visible)
        self.exchange.step(self.scene.environment.raw, self.scene.model["albedo"], phase.rates[""])
        self.adam.step(self.tensors(), phase.rates, self.scene.graph, phase.diffusion)
        self.iteration += 1
        values = {name: float(value.detach()) for name, value in terms.items() if name != "surface"}
        return values | self.surface_parts

    def render(self, view: View, level: int, light: LightField | None = None) -> Rendered:
        """Render a view with the current model."""
        return render_view(
            self.scene.model.activated(),
            view,
            light if light is not None else self.light(),
            backend=self.backend,
            fresnel=self.parameters.fresnel,
            mirror=self.parameters.mirror,
            occlusion=self.scene.occlusion.get((view.name, level)),
        )

    def render_whole(self, view: View) -> Rendered:
        """Render a view that is not one of the training views."""
        light, splats = self.light(), self.scene.model.activated()
        occlusion = self.trace_view(view, light, splats) if self.surface_occlusion is not None else None
        p = self.parameters
        return render_view(splats, view, light, backend=self.backend, fresnel=p.fresnel, mirror=p.mirror, occlusion=occlusion)

    def skip_to_consolidation(self) -> None:
        """Go on at the last phase: every view, falling learning rates."""
        p = self.parameters
        start = int(p.iterations * (1 - p.consolidate_fraction))
        self.iteration = max(self.iteration, start // CYCLE * CYCLE)

    def radiance_terms(self, view: View, predicted: torch.Tensor, target: torch.Tensor) -> dict[str, torch.Tensor]:
        """L_rgb of [P, 3] radiance: (1 - w) times the pixelwise loss and w times the structural one, as its two terms."""
        p, share = self.parameters, self.parameters.weight_dssim
        terms = {"rgb": p.weight_rgb * (1 - share) * losses.radiance_loss(predicted, target, view.colour_weight)}
        if share > 0 and len(view.pixels):
            unlike = dssim(losses.encode(predicted), losses.encode(target), view.pixels, view.size)
            terms["dssim"] = p.weight_rgb * share * unlike
        return terms

    def measured_terms(self, view: View, rendered: Rendered) -> dict[str, torch.Tensor]:
        """Radiance and polarisation losses, as the data allow."""
        p, weight = self.parameters, view.colour_weight
        if self.mode == "polarisers" and self.scene.bank is not None:
            predicted = self.scene.bank.intensity(rendered.stokes, view.camera.name)
            return self.radiance_terms(view, predicted, 2 * view.target[:, 0])
        terms = self.radiance_terms(view, rendered.stokes[:, 0], view.target[:, 0])
        if self.mode == "stokes" and p.weight_polarisation > 0:
            scale = p.weight_polarisation * POLARISATION_SCALE
            terms["polarisation"] = scale * losses.stokes_loss(rendered.stokes, view.target, weight)
        return terms

    def loss_terms(self, view: View, rendered: Rendered) -> dict[str, torch.Tensor]:
        """All weighted losses of Eq. 10."""
        p, model, graph = self.parameters, self.scene.model, self.scene.graph
        assert graph is not None
        splats = rendered.splats
        offsets = torch.stack([model["roughness_offset"], model["ior_offset"]], -1)
        terms = self.measured_terms(view, rendered)
        terms["mask"] = p.weight_mask * losses.mask_loss(rendered.gbuffer.alpha_image, view.alpha_target, view.alpha_weight)
        smooth = p.weight_smooth
        weights = SurfaceWeights(p.weight_depth_normal, smooth, 0.2 * smooth, smooth, 0.1 * smooth)
        terms["surface"], parts = surface_loss(graph, splats.means, splats.normals, splats.albedo, offsets, weights)
        self.surface_parts = {"depth_normal": float(parts[0]), "smooth": float(parts[1:].sum())}
        terms["environment"] = 0.002 * p.weight_environment * self.scene.environment.roughness_of()
        return terms

    @torch.no_grad()
    def validate(self) -> float:
        """Mean sRGB PSNR (dB) inside the mask of the validation views (of the training views where none are held back).

        NaN where no view shows anything.
        """
        showing = [v for v in self.pyramids[0] if v.inside.any()] or [v for v in self.pyramids[0] if len(v.pixels)]
        views = [v for v in showing if v.split == "validation"]
        views = views or [v for v in showing if v.split == "train"][:2]
        light = self.light()
        values = []
        for view in views:
            rendered = self.render(view, 0, light)
            predicted, target = rendered.stokes[:, 0], view.target[:, 0]
            if self.mode == "polarisers" and self.scene.bank is not None:
                predicted, target = self.scene.bank.intensity(rendered.stokes, view.camera.name), 2 * target
            inside = view.inside if view.inside.any() else torch.ones_like(view.inside)  # an object nowhere two pixels wide
            values.append(psnr(predicted[inside], target[inside], self.frame.exposure))
        return sum(values) / len(values) if values else float("nan")

    @torch.no_grad()
    def estimate_angles(self, level: int) -> dict[str, AngleFit]:
        """Closed-form angle of every polariser, from all training views."""
        bank = self.scene.bank
        if bank is None:
            return {}
        light = self.light()
        sums: dict[str, list[AngleSums]] = {name: [] for name in bank.names}
        for view in self.pyramids[level]:
            if view.split == "test":
                continue
            stokes = self.render(view, level, light).stokes
            # Weights of iteratively reweighted least squares: the fit then minimises what training minimises, and the
            # few pixels that the model cannot explain do not turn the angle.
            measured = 2 * view.target[:, 0]
            slope = losses.encode_slope(measured)
            residual = slope * (measured - bank.intensity(stokes, view.camera.name))
            robust = torch.rsqrt(residual**2 + losses.CHARBONNIER**2)
            weight = slope**2 * robust * (view.colour_weight * view.inside)[:, None]
            seen = AngleSums.empty()
            seen.add(stokes, measured, weight)
            sums[view.camera.name].append(seen)
        return {name: fit_views(sums[name], float(bank.contrast[k])) for k, name in enumerate(bank.names)}

    def state(self) -> dict[str, Any]:
        """Everything the next step depends on. Call it at a CYCLE boundary: graph and occlusion are rebuilt there."""
        tensors = {name: t.detach().clone() for name, t in self.tensors().items()}
        bank = self.scene.bank
        std, settled = (bank.std_deg, list(bank.settled)) if bank is not None else ([], [])
        return {
            "iteration": self.iteration,
            "tensors": tensors,
            "adam": self.adam.state(),
            "exchange": self.exchange.state(),
            "std_deg": list(std),
            "settled": settled,
            "activity": vars(self.activity),
            "hull": _as_tensors(self.scene.hull),
            "closed": None if self.scene.closed is None else _as_tensors(self.scene.closed),
            "hollowed": list(self.hollowed),
        }

    def load(self, state: dict[str, Any]) -> None:
        """Continue from a saved state."""
        tensors = dict(state["tensors"])
        with torch.no_grad():
            self.scene.environment.raw.copy_(tensors.pop("environment"))
            if self.scene.bank is not None:
                self.scene.bank.angles.copy_(tensors.pop("angles"))
                self.scene.bank.std_deg = list(state["std_deg"])
                self.scene.bank.settled = list(state["settled"])
        self.scene.model = SplatModel(tensors)
        self.adam.load(state["adam"])
        self.exchange.load(state["exchange"])
        self.activity = Activity(**state["activity"])
        self.scene.hull = _as_mesh(state["hull"])
        self.scene.closed = None if state["closed"] is None else _as_mesh(state["closed"])
        self.hollowed = list(state["hollowed"])
        self.iteration = state["iteration"]
        self.scene.graph = None


def _as_tensors(mesh: HullMesh) -> dict[str, torch.Tensor]:
    return {name: torch.as_tensor(value) for name, value in vars(mesh).items()}


def _as_mesh(tensors: dict[str, torch.Tensor]) -> HullMesh:
    return HullMesh(**{name: value.numpy() for name, value in tensors.items()})
