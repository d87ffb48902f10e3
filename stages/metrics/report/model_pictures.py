"""Pictures of a trained model: test views beside their truth, the environment, relit images."""

from __future__ import annotations

import base64
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.capture.naming.safe_names import environment_name
from pipeline.engine.stage import StageRun
from pipeline.formats import dataset_files as files
from pipeline.formats.backdrop import object_pixels
from pipeline.formats.gbuffer import PARTS, part_of, surface_of
from pipeline.formats.images import RGB, S0, channel_names, read_exr, read_image, read_stokes
from pipeline.geometry.lens import frames_folder
from pipeline.report import pictures
from pipeline.report.pictures import AOLP_FULL, DOLP_FULL, evenly_chosen, exposure_of, picture, polarisation

SHOWN_RELIT = 4  # views of every map
MOVING = (files.TURNTABLE, files.PATH)
ERROR_DEG = 30.0  # normal error at the bright end


def view_cards(run: StageRun, metrics: dict[str, Any]) -> list[dict[str, Any]]:
    """A card of pictures per shown test view."""
    train = run.inputs["train"]
    shown = evenly_chosen(files.held_back_views(train), run.parameters.shown_views)
    rows = {row["view"]: row for row in metrics.get("train", {}).get("views", []) if isinstance(row, dict)}
    return [{"view": v, "figures": rows.get(v, {}), "pictures": _view_pictures(run, v)} for v in shown]


def _view_pictures(run: StageRun, view: str) -> list[dict[str, str]]:
    path = files.held_back_image(run.inputs["train"], view)
    longest = run.parameters.picture_px
    stokes, channels = read_stokes(path), read_exr(path)
    surface = surface_of(channels)
    frame_path = files.frame(frames_folder(run.inputs), view)
    measured = read_image(frame_path, S0 if "S0.R" in channel_names(frame_path) else RGB)
    measured_stokes = read_stokes(frame_path) if "S1.R" in channel_names(frame_path) else None
    mask_path = files.mask(run.inputs["masks"], view) if "masks" in run.inputs else None
    inside = read_image(mask_path)[..., 0] if mask_path and mask_path.exists() else np.ones(measured.shape[:2])
    same = measured.shape[:2] == stokes.shape[:2] == inside.shape
    if same:
        compared = object_pixels(measured, inside > 0)
        measured, stokes = measured * compared[..., None], stokes * compared[..., None, None]
    box = pictures.crop_box([surface.alpha > 0.02, *([inside > 0.5] if same else [])])
    gain = exposure_of(measured) if same else 1.0
    behind = run.capture.polarisation == "polarisers"
    solid = surface.alpha > 0.5
    out: list[dict[str, str]] = []

    def add(pixels: NDArray[np.uint8], title: str, text: str) -> None:
        cut = pixels[box] if pixels.shape[:2] == stokes.shape[:2] else pixels
        surface = title == "normals" and not any(p["title"] == "normals" for p in out)  # light above, surface below
        out.append(picture(cut, title, text, longest, "first" if surface else ""))

    add(
        pictures.radiance(measured, gain),
        "photograph",
        "behind its polariser" if behind else "s0 measured",
    )
    add(pictures.radiance(stokes[:, :, 0], gain), "model", "s0 rendered, never seen in training")
    if measured_stokes is not None and same:
        difference = np.abs(stokes[:, :, 0] - measured).mean(-1) * gain
        add(pictures.scale(difference, 0, 0.1), "difference", "|s0|, white at 0.1 of display")
        dolp, aolp = polarisation(measured_stokes * inside[..., None, None])
        add(pictures.scale(dolp, 0, DOLP_FULL, mask=inside > 0.5), "DoLP", "measured")
    dolp_fit, aolp_fit = polarisation(stokes)
    add(pictures.scale(dolp_fit, 0, DOLP_FULL, mask=solid), "DoLP", "model")
    if measured_stokes is not None and same:
        add(pictures.angles(aolp, dolp / AOLP_FULL * (inside > 0.5)), "AoLP", "measured")
    add(pictures.angles(aolp_fit, dolp_fit / AOLP_FULL * solid), "AoLP", "model")
    normal, true = surface.normal, run.capture.truth.normal(view)
    if true is not None:
        add(pictures.normals(true), "normals", "truth")
        if true.shape == normal.shape:
            both = solid & (np.linalg.norm(true, axis=-1) > 0.5)
            error = np.degrees(np.arccos(np.clip((true * normal).sum(-1), -1, 1)))
            add(pictures.normals(normal), "normals", "model")
            add(pictures.scale(error, 0, ERROR_DEG, mask=both), "normal error", f"0 to {ERROR_DEG:.0f}°")
    else:
        add(pictures.normals(normal), "normals", "model")
    add(pictures.radiance(surface.albedo * surface.alpha[..., None]), "albedo", "diffuse reflectance")
    for part in PARTS:
        add(pictures.radiance(part_of(channels, part), gain), part, "part of s0")
    add(pictures.scale(surface.roughness, 0, 1, pictures.VIRIDIS, solid), "roughness", "perceptual, 0 to 1")
    add(pictures.scale(surface.ior, 1.3, 2.3, pictures.VIRIDIS, solid), "IoR", "1.3 to 2.3")
    return out


def environment_pictures(run: StageRun) -> list[dict[str, str]]:
    """The fitted environment beside the true one."""
    out = []
    truth, fit = run.capture.truth.environment, run.inputs["train"] / files.ENVIRONMENT
    if truth.is_file():
        out.append(picture(pictures.radiance(read_image(truth, RGB)), "truth", "the map that lit the capture", 560))
    if fit.is_file():
        out.append(picture(pictures.radiance(read_image(fit, RGB)), "fitted", "recovered from the object's shading alone", 560))
    return out


def relit_cards(run: StageRun, metrics: dict[str, Any]) -> list[dict[str, Any]]:
    """For every map: the map, and views beside their truth where there is one."""
    truth = run.capture.truth
    longest, out = run.parameters.picture_px, []
    maps = {environment_name(p): p for p in run.capture.environments}
    for folder in files.subfolders(run.inputs["relight"]):
        pics: list[dict[str, str]] = []
        views = {v: truth.find(f"relight/{folder.name}", v) for v in truth.views if files.relit(folder, v).exists()}
        judged = [v for v, path in views.items() if path is not None]
        for view in evenly_chosen(judged or list(views), SHOWN_RELIT):
            image, path = read_image(files.relit(folder, view), S0), views[view]
            box = pictures.crop_box([image.max(-1) > 1e-4])
            if path:
                pics.append(picture(pictures.radiance(read_image(path, S0))[box], f"view {view}", "path traced", longest))
            pics.append(picture(pictures.radiance(image)[box], f"view {view}", "relit model", longest))
        pics += [_moving(folder / f"{name}.webp", name) for name in MOVING if (folder / f"{name}.webp").is_file()]
        lamp = (
            picture(pictures.radiance(read_image(maps[folder.name], RGB)), folder.name, "the map", 560)
            if folder.name in maps
            else None
        )
        out.append(
            {"name": folder.name, "figures": metrics.get("relight", {}).get(folder.name, {}), "map": lamp, "pictures": pics}
        )
    return out


def _moving(path: Path, title: str) -> dict[str, str]:
    source = f"data:image/webp;base64,{base64.b64encode(path.read_bytes()).decode()}"
    return {"src": source, "title": title, "text": "the mesh with its baked material", "place": ""}
