"""What PRF's printed forms cost and buy against the defaults, on pixels with known truth: synthetic ones and captures."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.olat_settings import AT, SETTINGS, timed
from pipeline.capture import open_capture
from pipeline.formats.images import read_image
from pipeline.rig.light_table import LightTable
from pipeline.rig.solid_angles import solid_angles
from stages.olat.pixel_fit.many_pixels import fit
from synth.olat_pixels import Pixels, angle_deg, make, unit

FORMS = {
    "default": {},
    "diffuse_fit=active-set (Eq. 12)": {"plain": True},
    "specular_fit=half-vector": {"specular_fit": 1},
    "specular_fit=correlation (Eq. 13)": {"specular_fit": 2},
    "fusion=correlation": {"fuse_correlation": True},
    "lobe=ward": {"lobe": 0},
    "lobe=printed (Eq. 14, no cosine)": {"lobe": 2},
    "lobe=printed-cosine": {"lobe": 3},
    "one tangent a pixel": {"mixed": 0.0},
    "solver=gradient (Ma et al. 2007)": {"gradient": True},
}
EDGE = 2  # pixels of the mask's border left out


def table(name: str, p: Pixels) -> list[dict[str, float | str]]:
    """Median and mean errors of every form on these pixels, and its speed on one thread."""
    out: list[dict[str, float | str]] = []
    cross, parallel = p.cross.astype(np.float32), p.parallel.astype(np.float32)
    for form, change in FORMS.items():
        settings = SETTINGS._replace(**change)  # type: ignore[arg-type]
        seconds, (rows, _) = timed(lambda s=settings: fit(cross, parallel, p.view, p.rig, s, threads=1), 1)  # type: ignore[misc]
        row: dict[str, float | str] = {"pixels": name, "form": form}
        for key, label in (("diffuse_normal", "n_d"), ("specular_normal", "n_s"), ("normal", "fused")):
            error = angle_deg(rows[:, AT[key]], p.normal)
            row[f"{label}_median_deg"], row[f"{label}_mean_deg"] = float(np.median(error)), float(error.mean())
        row["sigma_rel"] = float(np.median(np.abs(rows[:, AT["sigma"]] / p.sigma - 1)))
        row["rho_d_rel"] = float(np.median(np.abs(rows[:, AT["diffuse_albedo"]] / np.maximum(p.albedo, 0.02) - 1)))
        row["rho_s_rel"] = float(np.median(np.abs(rows[:, AT["specular_albedo"]][:, 0] / p.specular - 1)))
        row["px_per_s"] = len(rows) / seconds
        out.append(row)
        print(
            f"  {name:10} {form:34} n_d {row['n_d_median_deg']:.2f}/{row['n_d_mean_deg']:.2f}"
            f"  n_s {row['n_s_median_deg']:.2f}/{row['n_s_mean_deg']:.2f}  fused {row['fused_median_deg']:.2f}"
            f"  sigma {row['sigma_rel']:.1%}  rho_d {row['rho_d_rel']:.2%}  rho_s {row['rho_s_rel']:.1%}"
            f"  {row['px_per_s']:.0f} px/s",
            flush=True,
        )
    return out


def synthetic() -> Pixels:
    """Anisotropic Beckmann pixels with shadows and noise."""
    return make(1000, lobe="beckmann", sigma=(0.3, 0.15), noise=1e-3, shadow=0.3, seed=5)


def captures(folder: Path) -> dict[str, tuple[Pixels, NDArray[np.bool_]]]:
    """Pixels of every light stage with ground truth in `folder`, by capture and camera, and where they lie [H, W]."""
    found = {}
    for root in sorted(path.parent for path in folder.glob("*/gt_brdf.json")):
        stage = open_capture(root).light_stage
        if stage is None:
            continue
        brdf = json.loads((root / "gt_brdf.json").read_text())
        for name, camera in stage.cameras.items():
            truth = root / name / "gt" / "maps.npz"
            if truth.is_file():
                found[f"{root.name}/{name}"] = _pixels(stage.lights, camera, np.load(truth), brdf)
    return found


def _pixels(lights, camera, truth, brdf) -> tuple[Pixels, NDArray[np.bool_]]:
    inside = truth["mask"] > 0.5
    for _ in range(EDGE):
        for axis in (0, 1):
            inside = inside & np.roll(inside, 1, axis) & np.roll(inside, -1, axis)
    area = lights.solid_angle if lights.solid_angle is not None else solid_angles(lights.directions)
    rig = LightTable(lights.directions, lights.positions, lights.intensity, area)
    cross, parallel = (
        np.stack([read_image(path, ("R", "G", "B"))[inside] for path in paths]) for paths in (camera.cross, camera.parallel)
    )
    normal, along = truth["normal"][inside].astype(float), truth["dp_du"][inside][..., :3].astype(float)
    along = unit(along - normal * np.sum(along * normal, 1, keepdims=True))
    u, v = brdf["sigma"]
    tangent = along if u >= v else np.cross(normal, along)
    count = len(normal)
    pixels = Pixels(
        rig, cross, parallel, -camera.camera.rays()[inside], normal, tangent, np.tile([max(u, v), min(u, v)], (count, 1)),
        truth["albedo"][inside][..., :3].astype(float), np.full(count, float(brdf["specular"])),
    )  # fmt: skip
    return pixels, inside
