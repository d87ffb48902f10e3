"""What training optimises, and what is derived from it as it goes."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import torch

from pipeline.shading import Occlusion

from .initialise.hull import HullMesh
from .log_environment import Environment
from .material_groups import Groups, groups_of
from .splats.carried_hull import CarriedHull, carried_hull
from .splats.gaussians import SplatModel
from .splats.splat_occlusion import SplatOcclusion
from .splats.surface_graph import SurfaceGraph, build_graph
from .views.polarisers import PolariserBank


@dataclass
class Scene:
    """Everything that is optimised (model, environment, polarisers) or derived from it, in the training frame.

    `graph` and what follows it are rebuilt as training goes, and are never saved.
    """

    model: SplatModel
    environment: Environment
    bank: PolariserBank | None
    hull: HullMesh  # open where openings were cut
    closed: HullMesh | None = None  # the same without cuts, where there are any
    graph: SurfaceGraph | None = None
    groups: Groups | None = None  # of splats whose material is found together; None: one, or not looked for yet
    occluder: CarriedHull | None = None  # the hull as the last tracing found it
    splat_occlusion: SplatOcclusion | None = None  # None: the object hides next to nothing from itself, or is not traced yet
    occlusion: dict[tuple[str, int], Occlusion] = field(default_factory=dict)  # by view and pyramid level

    def tensors(self) -> dict[str, torch.Tensor]:
        """Every optimised tensor by the name of its step rule (`schedule.STEP_RULES`)."""
        out = dict(self.model.tensors)
        out["environment"] = self.environment.raw
        if self.bank is not None:
            out["angles"] = self.bank.angles
        return out

    def link_neighbours(self) -> SurfaceGraph:
        """Build the surface graph anew from the splats as they are."""
        self.graph = build_graph(self.model["position"], self.model["normal"])
        return self.graph

    def linked(self) -> SurfaceGraph:
        """The surface graph, built where there is none."""
        return self.link_neighbours() if self.graph is None else self.graph

    def regroup(self) -> None:
        """Group the splats by their colour as it is."""
        self.groups = groups_of(self.model)

    def moved(self, hull: HullMesh) -> HullMesh:
        """A start surface as the splats have moved it since."""
        carried = carried_hull(hull, self.model)
        return HullMesh(carried.vertices, carried.triangles, carried.normals)

    def state(self) -> dict[str, Any]:
        """Everything that is optimised, and the hull, as tensors and lists."""
        bank = self.bank
        return {
            "tensors": {name: t.detach().clone() for name, t in self.tensors().items()},
            "std_deg": [] if bank is None else list(bank.std_deg),
            "settled": [] if bank is None else list(bank.settled),
            "hull": _as_tensors(self.hull),
            "closed": None if self.closed is None else _as_tensors(self.closed),
        }

    @torch.no_grad()
    def load(self, state: dict[str, Any]) -> None:
        """Take over a saved state; what is derived from it has to be built anew."""
        tensors = dict(state["tensors"])
        self.environment.raw.copy_(tensors.pop("environment"))
        if self.bank is not None:
            self.bank.angles.copy_(tensors.pop("angles"))
            self.bank.std_deg = list(state["std_deg"])
            self.bank.settled = list(state["settled"])
        self.model = SplatModel(tensors)
        self.hull = _as_mesh(state["hull"])
        self.closed = None if state["closed"] is None else _as_mesh(state["closed"])
        self.graph = None
        self.groups = None


def _as_tensors(mesh: HullMesh) -> dict[str, torch.Tensor]:
    return {name: torch.as_tensor(value) for name, value in vars(mesh).items()}


def _as_mesh(tensors: dict[str, torch.Tensor]) -> HullMesh:
    return HullMesh(**{name: value.numpy() for name, value in tensors.items()})
