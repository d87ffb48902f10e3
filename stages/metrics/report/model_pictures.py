"""Pictures of a trained model: test views beside their truth, the environment, relit images."""

from __future__ import annotations

import base64
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.capture.naming.safe_names import environment_name
from pipeline.engine.stage import StageRun
from pipeline.formats.backdrop import object_pixels
from pipeline.formats.images import channel_names, read_exr, read_image, read_stokes
from pipeline.geometry.lens import frames_folder
from pipeline.report import pictures
from pipeline.report.pictures import AOLP_FULL, DOLP_FULL, exposure_of, picture, polarisation

RGB, XYZ, S0 = ("R", "G", "B"), ("X", "Y", "Z"), ("S0.R", "S0.G", "S0.B")
ERROR_DEG = 30.0  # normal error at the bright end


def find_truth(root: Path, kind: str, view: str, names: list[str]) -> Path | None:
    """gt/KIND/VIEW.exr, or by the view's place."""
    for name in (view, f"{names.index(view):03d}" if view in names else ""):
        path = root / "gt" / kind / f"{name}.exr"
        if name and path.is_file():
            return path
    return None


def view_cards(run: StageRun, metrics: dict[str, Any]) -> list[dict[str, Any]]:
    """A card of pictures per shown test view."""
    train = run.inputs["train"]
    tests = sorted(p.stem for p in (train / "test").glob("*.exr"))
    shown = [
        tests[i]
        for i in sorted({round(k) for k in np.linspace(0, len(tests) - 1, min(len(tests), run.parameters.shown_views))})
    ]
    rows = {row["view"]: row for row in metrics.get("train", {}).get("views", []) if isinstance(row, dict)}
    return [{"view": v, "figures": rows.get(v, {}), "pictures": _view_pictures(run, v)} for v in shown]


def _view_pictures(run: StageRun, view: str) -> list[dict[str, str]]:
    path = run.inputs["train"] / "test" / f"{view}.exr"
    longest = run.parameters.picture_px
    stokes, channels = read_stokes(path), read_exr(path)
    names = sorted(v.view for v in run.capture.views)
    frame_path = frames_folder(run.inputs) / "frames" / f"{view}.exr"
    measured = read_image(frame_path, S0 if "S0.R" in channel_names(frame_path) else RGB)
    measured_stokes = read_stokes(frame_path) if "S1.R" in channel_names(frame_path) else None
    mask_path = run.inputs["masks"] / f"{view}.png" if "masks" in run.inputs else None
    inside = read_image(mask_path)[..., 0] if mask_path and mask_path.exists() else np.ones(measured.shape[:2])
    same = measured.shape[:2] == stokes.shape[:2] == inside.shape
    if same:
        compared = object_pixels(measured, inside > 0)
        measured, stokes = measured * compared[..., None], stokes * compared[..., None, None]
    box = pictures.crop_box([channels["alpha"] > 0.02, *([inside > 0.5] if same else [])])
    gain = exposure_of(measured) if same else 1.0
    behind = run.capture.polarisation == "polarisers"
    solid = channels["alpha"] > 0.5
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
        degree, angle = polarisation(measured_stokes * inside[..., None, None])
        add(pictures.scale(degree, 0, DOLP_FULL, mask=inside > 0.5), "DoLP", "measured")
    degree_fit, angle_fit = polarisation(stokes)
    add(pictures.scale(degree_fit, 0, DOLP_FULL, mask=solid), "DoLP", "model")
    if measured_stokes is not None and same:
        add(pictures.angles(angle, degree / AOLP_FULL * (inside > 0.5)), "AoLP", "measured")
    add(pictures.angles(angle_fit, degree_fit / AOLP_FULL * solid), "AoLP", "model")
    normal = np.stack([channels[f"N.{c}"] for c in "XYZ"], -1)
    truth = find_truth(run.capture.root, "normal", view, names)
    if truth:
        true = read_image(truth, XYZ)
        add(pictures.normals(true), "normals", "truth")
        if true.shape == normal.shape:
            both = solid & (np.linalg.norm(true, axis=-1) > 0.5)
            error = np.degrees(np.arccos(np.clip((true * normal).sum(-1), -1, 1)))
            add(pictures.normals(normal), "normals", "model")
            add(pictures.scale(error, 0, ERROR_DEG, mask=both), "normal error", f"0 to {ERROR_DEG:.0f}°")
    else:
        add(pictures.normals(normal), "normals", "model")
    rgb = [np.stack([channels[f"{k}.{c}"] for c in RGB], -1) for k in ("albedo", "diffuse", "specular")]
    add(pictures.radiance(rgb[0] * channels["alpha"][..., None]), "albedo", "diffuse reflectance")
    add(pictures.radiance(rgb[1], gain), "diffuse", "part of s0")
    add(pictures.radiance(rgb[2], gain), "specular", "part of s0")
    add(pictures.scale(channels["roughness"], 0, 1, pictures.VIRIDIS, solid), "roughness", "perceptual, 0 to 1")
    add(pictures.scale(channels["ior"], 1.3, 2.3, pictures.VIRIDIS, solid), "IoR", "1.3 to 2.3")
    return out


def environment_pictures(run: StageRun) -> list[dict[str, str]]:
    """The fitted environment beside the true one."""
    out = []
    truth, fit = run.capture.root / "gt" / "env.hdr", run.inputs["train"] / "env.exr"
    if truth.is_file():
        out.append(picture(pictures.radiance(read_image(truth, RGB)), "truth", "the map that lit the capture", 560))
    if fit.is_file():
        out.append(picture(pictures.radiance(read_image(fit, RGB)), "fitted", "recovered from the object's shading alone", 560))
    return out


def relit_cards(run: StageRun, metrics: dict[str, Any]) -> list[dict[str, Any]]:
    """For every map: the map, and views beside their truth where there is one."""
    names = sorted(v.view for v in run.capture.views)
    longest, out = run.parameters.picture_px, []
    maps = {environment_name(p): p for p in run.capture.environments}
    for folder in sorted(p for p in run.inputs["relight"].iterdir() if p.is_dir()):
        pics: list[dict[str, str]] = []
        gt = run.capture.root / "gt" / "relight" / folder.name
        views = [v for v in names if (folder / f"{v}.exr").exists()]
        judged = [v for v in views if (gt / f"{v}.exr").is_file() or (gt / f"{names.index(v):03d}.exr").is_file()]
        chosen = judged or views
        for view in [chosen[i] for i in sorted({round(k) for k in np.linspace(0, len(chosen) - 1, min(len(chosen), 4))})]:
            image = read_image(folder / f"{view}.exr", S0)
            box = pictures.crop_box([image.max(-1) > 1e-4])
            path = next((p for p in (gt / f"{view}.exr", gt / f"{names.index(view):03d}.exr") if p.is_file()), None)
            if path:
                pics.append(picture(pictures.radiance(read_image(path, S0))[box], f"view {view}", "path traced", longest))
            pics.append(picture(pictures.radiance(image)[box], f"view {view}", "relit model", longest))
        turntable = folder / "turntable.webp"
        if turntable.is_file():
            moving = base64.b64encode(turntable.read_bytes()).decode()
            pics.append(
                {
                    "src": f"data:image/webp;base64,{moving}",
                    "title": "turntable",
                    "text": "the mesh with its baked material",
                    "place": "",
                }
            )
        lamp = (
            picture(pictures.radiance(read_image(maps[folder.name], RGB)), folder.name, "the map", 560)
            if folder.name in maps
            else None
        )
        out.append(
            {"name": folder.name, "figures": metrics.get("relight", {}).get(folder.name, {}), "map": lamp, "pictures": pics}
        )
    return out
