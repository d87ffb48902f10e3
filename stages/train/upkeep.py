"""What is done to the scene between steps: surface graph, densification, tracing, and the search for concavities."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch

from .indirect.gridmap_or_harmonics import GRIDMAP_EVERY
from .parameters import TrainParameters
from .renderer import Renderer
from .scene import Scene
from .splats.densify import Activity, edges_to_split, keep, kept_rows, split_edges
from .splats.optimiser import SurfaceAdam
from .views.source_views import Mode
from .views.view import View

REFRESH = 100  # steps between rebuilding the surface graph: splats move by a fraction of their spacing meanwhile
CYCLE = 2 * REFRESH  # steps between densifications
DENSIFY_UNTIL = 0.6  # share of the run after which the splats stay as they are
MOST_REMOVED = 0.5  # share of the splats from which on none is removed: the images are then at fault, not the splats
LATE_FROM = 200  # steps before the first tracing without full Stokes, or of what stands in for it: light and albedo must mean
# something
TRACE_AT_FIRST = 100  # steps between two tracings at first, later a quarter of the steps done, up to CYCLE: before light is
# traced a crease's normals turn to where the sky explains it, and a tracing of turned normals keeps them there
CONCAVITIES_AT = (200, 400, 600)  # steps (of CYCLE) before which hollows are looked for: the light must be about right
CONCAVITIES_UNTIL = 0.6  # share of the run after which there is no time left to settle
LEAST_CONCAVITY = 0.004  # share of the surface below which it is not worth looking again: 20 of the search's samples
ROUNDS = 4  # searches in a row: when a film is gone, the next finds what lies deeper yet


class Upkeep:
    """Keeps a scene fit for training.

    Args:
        scene, adam, renderer: what is trained, its optimiser (whose moments follow the splats), and how it is rendered.
        views: the training views at full size.
        mode: what the views hold.
        parameters: the stage's.

    Attributes:
        activity: what the images did to each splat since the last densification; `Trainer.step` adds to it.
        hollowed: share of the surface that each search so far found to lie deeper.
        most: splats that there may be.
    """

    def __init__(
        self,
        scene: Scene,
        adam: SurfaceAdam,
        renderer: Renderer,
        views: Sequence[View],
        mode: Mode,
        parameters: TrainParameters,
    ) -> None:
        self.scene, self.adam, self.renderer = scene, adam, renderer
        self.views, self.mode, self.parameters = views, mode, parameters
        self.hollowed: list[float] = []
        self.most = min(parameters.max_splats, round(len(scene.model) / parameters.start_fraction))
        self.traced_level: int | None = None
        self.forget_activity()

    @property
    def period(self) -> int:
        """Steps between two tracings, and between checkpoints: nothing traced has to be saved then."""
        return GRIDMAP_EVERY if self.parameters.indirect == "gridmap" else CYCLE

    def forget_activity(self) -> None:
        """Begin to count anew."""
        model = self.scene.model
        self.activity = Activity.empty(len(model), model["position"].device)

    def state(self) -> dict[str, Any]:
        """What a resume needs beside the scene."""
        return {"activity": vars(self.activity), "hollowed": list(self.hollowed)}

    def load(self, state: dict[str, Any]) -> None:
        """Take over a saved state."""
        self.activity, self.hollowed = Activity(**state["activity"]), list(state["hollowed"])

    def due(self, iteration: int, level: int) -> bool:
        """Whether there is anything to do before a step on images of a pyramid level."""
        return iteration % REFRESH == 0 or self.scene.graph is None or self.traces_before(iteration, level)

    def refresh(self, iteration: int, views: Sequence[View], level: int) -> None:
        """What is due before step `iteration`; `views` of the pyramid level in use are traced."""
        if iteration % REFRESH == 0 or self.scene.graph is None:
            self.scene.link_neighbours()
        if iteration % CYCLE == 0 and iteration > 0:
            self.densify(iteration)
        traces = self.traces_before(iteration, level)
        if traces:
            self.renderer.trace(views, level)
            self.traced_level = level
        for _ in range(ROUNDS if self.looks_for_concavities(iteration) else 0):
            if not self.hollow_out():
                break
            if traces:
                self.renderer.trace(views, level)

    def traces_before(self, iteration: int, level: int) -> bool:
        """Whether what the object does to its own light is looked at anew before a step on images of a pyramid level."""
        if self.traced_level not in (None, level):
            return True  # the pixels are others
        indirect = self.parameters.indirect
        if indirect != "traced" or self.mode != "stokes":
            return indirect != "none" and iteration >= LATE_FROM and iteration % self.period == 0
        every = TRACE_AT_FIRST
        while 2 * every <= min(iteration // 4, CYCLE):
            every *= 2
        return iteration % every == 0

    def densify(self, iteration: int) -> None:
        """Remove what does not show, then add where the images pull hardest, up to the bound, while there is time."""
        p, model = self.parameters, self.scene.model
        if p.densify and iteration / p.iterations <= DENSIFY_UNTIL:
            self._remove_faint()
            split_edges(model, self.adam, edges_to_split(self.scene.linked(), self.activity, self.most - len(model)))
            self.scene.link_neighbours()
        self.forget_activity()

    def _remove_faint(self) -> None:
        """Remove the splats that the images made transparent."""
        model = self.scene.model
        rows = kept_rows(torch.sigmoid(model["opacity"].detach()))
        if len(model) > len(rows) > int((1 - MOST_REMOVED) * len(model)):
            keep(model, self.adam, rows)
            self.activity = self.activity.rows(rows)
            self.scene.link_neighbours()

    def looks_for_concavities(self, iteration: int) -> bool:
        """Whether a search is due: the data can tell, there is time to settle, and the last search was not in vain."""
        p = self.parameters
        due = iteration in CONCAVITIES_AT and iteration <= CONCAVITIES_UNTIL * p.iterations
        return p.searches_concavities(self.mode) and due and (not self.hollowed or self.hollowed[-1] >= LEAST_CONCAVITY)

    @torch.no_grad()
    def hollow_out(self) -> bool:
        """Look for hollows that no silhouette shows, and move the surface into them; whether any splat made way.

        The splats elsewhere stay. What the object hides from itself must have been traced on the surface as it is.
        """
        from .concavity.explanation import shading_tables
        from .concavity.hollow import DepthField, hollowed
        from .concavity.refit import refit
        from .concavity.samples import view_images
        from .concavity.search import surface_depths

        scene, p, spacing = self.scene, self.parameters, self.scene.linked().spacing
        surface = scene.moved(scene.hull)
        occlusion = {name: traced for (name, level), traced in scene.occlusion.items() if level == 0}
        images = view_images(self.views, self.mode, scene.bank, occlusion)
        splats = scene.model.activated()
        shading = shading_tables(splats, self.renderer.light(), p.fresnel)
        points, albedo = splats.means.detach().cpu().numpy(), splats.albedo.detach().cpu().numpy()
        found = surface_depths(surface, images, shading, points, albedo, p.seed)
        self.hollowed.append(found.share)
        if found.share < LEAST_CONCAVITY:
            return False
        field = DepthField(found.points, found.depths)
        hollow = hollowed(surface if scene.closed is None else scene.moved(scene.closed), field, spacing)
        if hollow is None or refit(scene.model, self.adam, field, hollow, spacing, self.most, p.seed) is None:
            return False
        scene.hull, scene.closed = hollow, None
        scene.link_neighbours()
        self.forget_activity()
        return True
