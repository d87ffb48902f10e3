"""Mesh: fuse every view's depth into a signed distance field, extract it, clean it, bake the material onto it."""

from __future__ import annotations

from pipeline.capture import Capture
from pipeline.capture.view_rules import too_few_views
from pipeline.engine.stage import Decision, Stage, StageRun
from stages import memory_estimate

from .parameters import MeshParameters


def needed(capture: Capture, parameters: MeshParameters) -> Decision:
    """Only where a model is trained: depth comes from it."""
    if capture.kind == "light_stage":
        return Decision(False, "a light stage has no views all around, so no model to take a surface from")
    if few := too_few_views(capture):
        return Decision(False, few)
    return Decision(True, "a model is trained: its depth images become a surface")


def run(run: StageRun) -> None:
    """Write mesh.ply (and mesh_poisson.ply when asked)."""
    from .run import make_mesh

    make_mesh(run)


STAGE = Stage("mesh", 2, MeshParameters, ("poses", "train"), needed, run, memory=memory_estimate.mesh)
