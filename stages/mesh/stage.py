"""Mesh: one surface with its material, from a model's depth images or from all cameras' maps of a light stage."""

from __future__ import annotations

from pipeline.capture import Capture
from pipeline.capture.view_rules import FEWEST_CAMERAS, too_few_views
from pipeline.engine.stage import Decision, Stage, StageRun
from stages import memory_estimate, time_estimate

from .parameters import MeshParameters


def needed(capture: Capture, parameters: MeshParameters) -> Decision:
    """Where a model is trained, whose depth images it fuses, or three cameras of a light stage see an object from around."""
    if capture.light_stage is not None:
        count = len(capture.light_stage.cameras)
        if count < FEWEST_CAMERAS:
            return Decision(False, f"only {count} camera{'s' * (count > 1)}; a light stage's surface needs {FEWEST_CAMERAS}")
        return Decision(True, f"the masks and normals of {count} cameras become one surface, and their maps its material")
    if few := too_few_views(capture):
        return Decision(False, few)
    passes = {
        "textures": Decision(parameters.textures, "asked for" if parameters.textures else "switched off (mesh.textures)"),
        "poisson": Decision(parameters.poisson, "asked for" if parameters.poisson else "not asked for (mesh.poisson)"),
    }
    return Decision(True, "a model is trained: its depth images become a surface", passes)


def run(run: StageRun) -> None:
    """Write mesh.ply and asset/ (and mesh_poisson.ply when asked)."""
    if run.capture.kind == "light_stage":
        from .rig_object import make_rig_mesh

        make_rig_mesh(run)
        return
    from .run import make_mesh

    make_mesh(run)


STAGE = Stage(
    "mesh", 9, MeshParameters, ("decode", "poses", "masks", "olat", "train"), needed, run, config=("up", "unit_m"),
    memory=memory_estimate.mesh, costs=time_estimate.mesh, parallel=0.2,
)  # fmt: skip
