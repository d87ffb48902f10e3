"""The trained Gaussians as viewers want them: upright, in metres."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np

from pipeline.errors import UserError
from pipeline.formats import dataset_files as files
from pipeline.formats.json_file import read_json
from pipeline.formats.ply import Ply
from pipeline.geometry.world import Y_UP_FROM
from pipeline.splats.gltf import write_splat_glb
from pipeline.splats.splat_ply import read_splat_ply, write_splat_ply
from pipeline.splats.spz import write_spz

Y_DOWN = np.diag([1.0, -1.0, -1.0])
"""From y up to the axes that viewers take a PLY's for: y down, z forward."""


def export_splats(train: Path, unit_m: float | None, folder: Path) -> None:
    """Write splat.ply (material, the capture's world) and splats_lit.ply, .spz, .glb (upright, metres where known).

    Args:
        train: that stage's folder.
        unit_m: metres per world unit; None: not known.
        folder: to write to.

    Raises:
        UserError: the lit ones were not made.
    """
    lit = train / files.LIT_SPLATS
    if not lit.exists():
        raise UserError(lit, "was not made by the version of the train stage that ran", "`polarfield train` makes it")
    up = Y_UP_FROM[read_json(train / files.LIGHTING, "run the train stage again")["up"]]
    upright = read_splat_ply(lit).turned(up, unit_m or 1.0)
    as_ply = upright.turned(Y_DOWN)
    shutil.copyfile(train / files.GAUSSIANS, folder / "splat.ply")
    write_splat_ply(folder / "splats_lit.ply", as_ply)
    write_spz(folder / "splats_lit.spz", as_ply)
    ply = Ply(train / files.GAUSSIANS)
    material = {
        "albedo": ply.vertices(("albedo_r", "albedo_g", "albedo_b")),
        "normal": ply.vertices(("nx", "ny", "nz")) @ up.T,
        "roughness": ply.vertices(("roughness",))[:, 0],
        "ior": ply.vertices(("ior",))[:, 0],
    }
    write_splat_glb(folder / "splats_lit.glb", upright, material)
