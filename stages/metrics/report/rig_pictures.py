"""Pictures of a light stage: fitted maps and relit cameras."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.capture.light_stage.folders import home_of
from pipeline.capture.naming.safe_names import environment_name
from pipeline.engine.stage import StageRun
from pipeline.formats import dataset_files as files
from pipeline.formats.ground_truth import camera_maps
from pipeline.formats.images import RGB, XYZ, read_exr, read_image
from pipeline.report import pictures
from pipeline.report.pictures import picture

ERROR_FULL = 0.5  # difference over the mean of the frames' sum, at the bright end
FLAGS = (
    ("black", (24, 26, 30), "good"),
    ("yellow", (214, 158, 46), "too few lights"),
    ("red", (197, 48, 48), "saturated"),
    ("grey", (90, 90, 90), "black"),
    ("blue", (49, 130, 206), "no lobe"),
    ("violet", (128, 90, 213), "bad samples"),
    ("orange", (221, 107, 32), "facing away"),
    ("teal", (49, 151, 149), "peak outside the lights"),
)
"""Colour and meaning of the olat stage's flags 0, 1, ..."""


STANDARD_DEVIATIONS = (
    ("std_normal", "normals: standard deviation", "degrees, 0 to its 98th percentile"),
    ("std_diffuse_normal", "diffuse normals: standard deviation", "degrees, 0 to its 98th percentile"),
    ("std_specular_normal", "specular normals: standard deviation", "degrees, 0 to its 98th percentile"),
    ("std_diffuse_albedo", "diffuse albedo: standard deviation", "0 to its 98th percentile"),
    ("std_specular_albedo", "specular albedo: standard deviation", "0 to its 98th percentile"),
    ("std_sigma", "σ: standard deviation", "0 to its 98th percentile"),
)


def olat_cards(run: StageRun, metrics: dict[str, Any]) -> list[dict[str, Any]]:
    """A card of maps per camera."""
    rows = {row["view"]: row for row in metrics.get("olat", {}).get("views", []) if isinstance(row, dict)}
    folders = files.subfolders(run.inputs["olat"])
    return [{"view": f.name, "figures": rows.get(f.name, {}), "pictures": _maps(run, f)} for f in folders]


def _maps(run: StageRun, folder: Path) -> list[dict[str, str]]:
    longest = run.parameters.picture_px
    normal = read_image(files.camera_map(folder, "normal"), XYZ)
    there = np.linalg.norm(normal, axis=-1) > 0.5
    box = pictures.crop_box([there])
    out: list[dict[str, str]] = []

    def add(pixels: np.ndarray, title: str, text: str) -> None:
        out.append(picture(pixels[box], title, text, longest))

    def fitted(name: str, channels: Sequence[str]) -> np.ndarray:
        return read_image(files.camera_map(folder, name), channels)

    def one(name: str, channel: str = "Y") -> np.ndarray:
        return fitted(name, (channel,))[..., 0]

    add(pictures.radiance(fitted("diffuse_albedo", RGB)), "diffuse albedo", "ρ_d")
    add(pictures.scale(one("specular_albedo"), 0, 1, mask=there), "specular albedo", "ρ_s, 0 to 1")
    truth = camera_maps(home_of(run.capture.root, folder.name))
    if truth is not None:
        true, inside = truth["normal"], truth["mask"] > 0.5
        if true.shape == normal.shape:
            add(pictures.normals(true), "normals", "truth")
            error = np.degrees(np.arccos(np.clip((true * normal).sum(-1), -1, 1)))
            add(pictures.normals(normal), "normals", "fused")
            add(pictures.scale(error, 0, 10, mask=there & inside), "normal error", "0 to 10°")
    else:
        add(pictures.normals(normal), "normals", "fused")
    add(pictures.normals(fitted("diffuse_normal", XYZ)), "diffuse normals", "from the Lambert term")
    add(pictures.normals(fitted("specular_normal", XYZ)), "specular normals", "from the lobe")
    sigma = fitted("sigma", ("X", "Y"))
    add(pictures.scale(sigma[..., 0], 0, 0.6, pictures.VIRIDIS, there), "larger σ", "0 to 0.6")
    add(pictures.scale(sigma[..., 1], 0, 0.6, pictures.VIRIDIS, there), "smaller σ", "0 to 0.6")
    add(pictures.scale(one("anisotropy"), 0, 1, pictures.VIRIDIS, there), "anisotropy", "0 to 1")
    add(pictures.scale(one("roughness"), 0, 1, pictures.VIRIDIS, there), "roughness", "r = (σx σy)^¼, 0 to 1")
    tangent = pictures.to_bytes(np.abs(fitted("tangent", XYZ)))
    add(tangent, "tangent", "direction of the larger σ, |x y z| as red green blue; black: none")
    for ending, what in (("d", "diffuse"), ("s", "specular")):
        for name, text in (("visibility", "share of lights seen"), ("occlusion", "share of light arriving")):
            add(pictures.scale(one(f"{name}_{ending}"), 0, 1, pictures.VIRIDIS, there), f"{what} {name}", text)
    add(pictures.radiance(fitted("interreflection_d", RGB)), "diffuse inter-reflection", "light from behind the surface")
    add(shown_to_its_own_top(one("interreflection_s"), there), "specular inter-reflection", "0 to its 98th percentile")
    for name, title, text in STANDARD_DEVIATIONS:
        if files.camera_map(folder, name).is_file():
            add(shown_to_its_own_top(one(name), there), title, text)
    add(pictures.scale(one("residual"), 0, 0.5, mask=there), "residual", "relative RMS, 0 to 0.5")
    flag = np.clip(one("residual", "flag").round().astype(int), 0, len(FLAGS) - 1)
    colours = np.array([rgb for _, rgb, _ in FLAGS], np.uint8)[flag] * there[..., None].astype(np.uint8)
    add(colours, "flags", flag_legend(flag[there]))
    return out


def shown_to_its_own_top(values: np.ndarray, there: np.ndarray) -> np.ndarray:
    """A map's values as colours, from 0 to the 98th percentile of those on the object."""
    top = float(np.percentile(values[there], 98)) if there.any() else 0.0
    return pictures.scale(values, 0, top or 1.0, pictures.VIRIDIS, there)


def disagreement_cards(run: StageRun) -> list[dict[str, Any]]:
    """How far each light-stage camera's maps are from what all cameras say together, where a mesh was made of them."""
    folder = run.inputs["mesh"] / files.DISAGREEMENT if "mesh" in run.inputs else None
    if folder is None or not folder.is_dir():
        return []
    out = []
    for path in sorted(folder.glob("*.exr")):
        found = read_exr(path)
        there = found["normal_deg"] > 0
        box = pictures.crop_box([there])
        tops = (
            ("normal_deg", 5, "normals", "0 to 5°"), ("diffuse_albedo", 0.2, "diffuse albedo", "relative, 0 to 0.2"),
            ("specular_albedo", 0.5, "specular albedo", "relative, 0 to 0.5"), ("sigma", 0.5, "σ", "relative, 0 to 0.5"),
        )  # fmt: skip
        pics = [
            picture(pictures.scale(found[name], 0, top, mask=there)[box], title, text, run.parameters.picture_px)
            for name, top, title, text in tops
        ]
        out.append({"view": path.stem, "figures": {}, "pictures": pics})
    return out


def flag_legend(flags: np.ndarray) -> str:
    """The colours of the flags that the pixels [P] of an object have, with their shares."""
    share = np.bincount(flags, minlength=len(FLAGS)) / max(len(flags), 1)
    there = [f"{colour} {meaning} ({100 * s:.1f} %)" for s, (colour, _, meaning) in zip(share[1:], FLAGS[1:]) if s > 0]
    return ", ".join(there) or "none"


def _in_reading_order(path: Path) -> tuple[str, int]:
    """Camera by camera: the frames' sum, what the maps make of it, the difference."""
    order = 0 if path.stem.endswith(files.SUMMED) else 2 if path.stem.endswith(files.ERROR) else 1
    return path.stem.removesuffix(files.SUMMED).removesuffix(files.ERROR), order


def relit_cards(run: StageRun) -> list[dict[str, Any]]:
    """For every map: the map, and each camera from the frames and from the fitted maps."""
    out = []
    maps = {environment_name(p): p for p in run.capture.environments}
    for folder in files.subfolders(run.inputs["relight"]):
        pics = []
        for path in sorted(folder.glob("cam*.exr"), key=_in_reading_order):
            if path.stem.endswith(files.ERROR):
                error = read_image(path, ("Y",))[..., 0]
                shown = pictures.scale(error, 0, ERROR_FULL)[pictures.crop_box([error > 0])]
                title = path.stem.removesuffix(files.ERROR)
                pics.append(picture(shown, title, f"difference, 0 to {ERROR_FULL:g}", run.parameters.picture_px))
                continue
            image = read_image(path, RGB)
            what = "sum of the frames" if path.stem.endswith(files.SUMMED) else "rendered from the maps"
            box = pictures.crop_box([image.max(-1) > 1e-4])
            pics.append(
                picture(pictures.radiance(image)[box], path.stem.removesuffix(files.SUMMED), what, run.parameters.picture_px)
            )
        lamp = None
        if folder.name in maps:
            lamp = picture(pictures.radiance(read_image(maps[folder.name], RGB)), folder.name, "the map", 560)
        out.append({"name": folder.name, "figures": {}, "map": lamp, "pictures": pics})
    return out
