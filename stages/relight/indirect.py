"""`relight.indirect`: what the views' pixels receive of the object itself under every map, by the kind that is asked for."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import torch
from numpy.typing import NDArray

from pipeline.engine.stage import StageRun
from pipeline.errors import UserError
from pipeline.formats import dataset_files as files
from pipeline.formats.images import RGB, read_image
from pipeline.geometry.occluder import Occluder, simplified
from pipeline.geometry.world import Y_UP_FROM
from pipeline.shading import Occlusion
from pipeline.shading.gridmap import GridMap, LocalLight, nearest_albedo
from pipeline.shading.occluded import LEAST_BLOCKED, blocked_share

from .deferred import Lamp, ShadingModel, Surface
from .mesh_images import read_baked_mesh
from .mesh_shadows import FACES, SelfOcclusion


class Indirect(Protocol):
    """Light that the mesh takes from and sends to itself. `light` is of one map, `attachment` of one view."""

    def under(self, lamp: Lamp) -> Any:
        """Its light under a map."""

    def on_mesh(self, light: Any) -> NDArray[np.float32]:
        """Shadow and bounced light [V, 6] at the vertices of mesh.ply."""

    def attach(self, surface: Surface, own_rays: bool = False, name: str = "") -> Any:
        """Rays of the points of a view of this name, whatever the map."""

    def at(self, attachment: Any, light: Any) -> Occlusion:
        """What shading needs at a view's points under one map."""


@dataclass(frozen=True)
class Seen:
    """P points of a view in the maps' frame [P, 3], and which mirror the object [P]; learnt [P, 3]: its radiance there."""

    points: NDArray
    normals: NDArray
    view: NDArray
    roughness: NDArray
    blocked: NDArray[np.bool_]
    learnt: NDArray | None = None


class _Mesh:
    """The mesh as an occluder in the maps' frame (y up)."""

    def __init__(self, mesh: Path, model: ShadingModel) -> None:
        self.vertices, self.attributes, faces = read_baked_mesh(mesh)
        self.turn, self.model = Y_UP_FROM[model.up], model
        coarse, triangles = simplified(self.vertices, faces, FACES)
        self.coarse, self.occluder = coarse, Occluder(coarse @ self.turn.T, triangles)

    def seen(self, surface: Surface, learnt: NDArray | None = None) -> Seen:
        """A view's points and their mirror rays, which begin on the mesh."""
        points, normals, view = (np.asarray(v @ self.turn.T) for v in (surface.position, surface.normal, surface.view))
        near = self.occluder.nearest(points)
        start = np.einsum("pk,pkc->pc", near.weights, self.occluder.vertices[near.vertices])
        mirror = 2 * (normals * view).sum(-1, keepdims=True) * normals - view
        blocked = self.occluder.cast(start + self.occluder.lift * normals, mirror).blocked
        return Seen(points, normals, view, surface.material[:, 3], blocked, learnt)


class EnvironmentsOnMesh(_Mesh):
    """PhyGaP's GridMap."""

    def __init__(self, mesh: Path, model: ShadingModel, weights: str, anchors: str) -> None:
        super().__init__(mesh, model)
        albedo = nearest_albedo(self.vertices, self.attributes[:, 3:6], self.coarse)
        self._grid = GridMap(
            self.occluder, albedo, weights=weights, anchors=anchors, lobe=model.lobe, fresnel=model.fresnel
        )  # fmt: skip

    def under(self, lamp: Lamp) -> LocalLight:
        """What the anchors see under a map."""
        return self._grid.light(lamp.cube, lamp.light)

    def on_mesh(self, light: LocalLight) -> NDArray[np.float32]:
        """Shadow and bounced light [V, 6] at the vertices of mesh.ply."""
        received = self._grid.received(self.vertices @ self.turn.T, self.attributes[:, :3] @ self.turn.T, light)
        return np.concatenate([np.zeros_like(received), received], 1)

    def attach(self, surface: Surface, own_rays: bool = False, name: str = "") -> Seen:
        """Mirror rays of a view's points."""
        return self.seen(surface)

    def at(self, attachment: Seen, light: LocalLight) -> Occlusion:
        """What shading needs at a view's points under one map."""
        a = attachment
        return self._grid.occlusion(a.points, a.normals, a.view, a.roughness, light, a.blocked)


class HarmonicsOnMesh(_Mesh):
    """Ref-Gaussian's: mirrored light that the object blocks is what training has learnt, under whatever map it is lit by."""

    def __init__(self, mesh: Path, model: ShadingModel, train: Path) -> None:
        super().__init__(mesh, model)
        self._train = train
        if not files.learnt_light(train, "").parent.is_dir():
            remedy = "train with train.indirect=sh, or choose another relight.indirect"
            raise UserError(train, "relight.indirect=sh: training has learnt no indirect light", remedy)

    def under(self, lamp: Lamp) -> None:
        """Nothing: it is what it was in the capture."""

    def on_mesh(self, light: None) -> NDArray[np.float32]:
        """Shadow and bounced light [V, 6] at the vertices of mesh.ply: diffuse light goes free."""
        return np.repeat(np.array([[1, 0]], np.float32), 3, 1).repeat(len(self.vertices), 0)

    def attach(self, surface: Surface, own_rays: bool = False, name: str = "") -> Seen:
        """Mirror rays of a view's points, and what was learnt there."""
        if surface.pixels is None:  # between a view's pixels, at an outline: nothing is known there
            free = self.seen(surface, np.zeros_like(surface.position))
            return replace(free, blocked=np.zeros_like(free.blocked))
        image = read_image(files.learnt_light(self._train, name), RGB)
        return self.seen(surface, image.reshape(-1, 3)[surface.pixels])

    def at(self, attachment: Seen, light: None) -> Occlusion:
        """What shading needs at a view's points under one map."""
        assert attachment.learnt is not None
        blocked = torch.as_tensor(attachment.blocked.astype(np.float32))
        learnt = torch.as_tensor(np.ascontiguousarray(attachment.learnt, np.float32))
        return Occlusion(torch.ones_like(learnt), torch.zeros_like(learnt), 1 - blocked, blocked[:, None] * learnt)


def indirect_light(run: StageRun, model: ShadingModel) -> Indirect | None:
    """What `relight.indirect` asks for, or None where it is off, or nothing is occluded; says which and why."""
    p = run.parameters
    kind = model.indirect if p.indirect == "auto" else p.indirect
    mesh = run.inputs.get("mesh")
    reason = "relight.indirect=none" if p.indirect == "none" else "training saw no self-occlusion"
    if kind != "none" and mesh is None:
        kind, reason = "none", "there is no mesh"
    made: Indirect | None = None
    if kind != "none" and mesh is not None:
        made = _made(kind, mesh / files.MESH, model, run)
        if made is None:
            reason = "next to nothing of the mesh hides any other part of it"
    if made is not None:
        reason = f"{kind}: the object occludes itself"
    run.note("indirect", {"run": made is not None, "reason": reason})
    return made


def _made(kind: str, mesh: Path, model: ShadingModel, run: StageRun) -> Indirect | None:
    """The indirect light of a kind; None where training did not find that the object occludes itself, and it does not."""
    if not model.occlusion:
        vertices, _, faces = read_baked_mesh(mesh)
        if blocked_share(Occluder(*simplified(vertices, faces, FACES))) < LEAST_BLOCKED:
            return None
    if kind == "gridmap":
        return EnvironmentsOnMesh(mesh, model, run.parameters.gridmap_weights, run.parameters.gridmap_anchors)
    return HarmonicsOnMesh(mesh, model, run.inputs["train"]) if kind == "sh" else SelfOcclusion(mesh, model)


def traced(run: StageRun, model: ShadingModel, occluder: Indirect | None) -> SelfOcclusion | None:
    """The mesh's shadows for lights that stand in the world: those in use, or made for them where these are of another kind."""
    if occluder is None or isinstance(occluder, SelfOcclusion):
        return occluder
    return SelfOcclusion(run.inputs["mesh"] / files.MESH, model)
