"""Make the masks of a capture by the chosen method, check them, and write them."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.capture.naming.files import count, some
from pipeline.engine.stage import StageRun
from pipeline.errors import UserError
from pipeline.formats.images import read_image, read_stokes, write_png
from pipeline.geometry.cameras import Camera
from pipeline.geometry.lens import frame_table, frames_folder, lenses
from pipeline.geometry.worlds import ONE_WORLD
from stages.masks.parameters import choose_method

THRESHOLD = 127
CHECK_SIZE = 240


def make_masks(stage: StageRun) -> None:
    """Fill the stage's folder. Raises UserError on masks that cannot be meant."""
    method, reason = choose_method(stage.capture, stage.parameters)
    make = light_stage_masks if stage.capture.kind == "light_stage" else multiview_masks
    masks = make(stage, method)
    methods = {name: used for name, (_, used) in masks.items()}
    pixels = {name: mask for name, (mask, _) in masks.items()}
    views: dict[str, dict[str, Any]] = {}
    for name, mask in sorted(pixels.items()):
        write_png(stage.output / f"{name}.png", mask)
        views[name] = {"method": methods[name], "coverage": float((mask > THRESHOLD).mean())}
        if views[name]["coverage"] == 0:
            views[name]["left_out"] = "the mask is empty"
    refuse_two_worlds(stage, pixels)
    if stage.parameters.hull_check and stage.capture.kind == "multiview":
        flag_disagreement(stage, pixels, views)
    if stage.capture.polarisation == "stokes":
        say_if_frame_looks_wrong(stage, pixels)
    empty = [name for name in sorted(views) if views[name]["coverage"] == 0]
    if len(empty) == len(views):
        raise UserError(stage.capture.root, "no view shows the object: every mask is empty", "give masks/, white on the object")
    if empty:
        stage.warn(
            f"{stage.capture.root}: the mask is empty in {count(empty, 'view')} ({some(empty)}), which nothing is learnt from: "
            "look at the masks"
        )
    table = {"schema": 1, "method": method, "reason": reason, "views": views}
    (stage.output / "masks.json").write_text(json.dumps(table, indent=1) + "\n", encoding="utf-8")


def flag_disagreement(stage: StageRun, masks: dict[str, NDArray[np.uint8]], views: dict[str, dict[str, Any]]) -> None:
    """Hold the masks against each other's visual hull; tell the user of those that do not fit."""
    from stages.masks.inputs import cameras_of

    cameras = cameras_of(stage)
    names = [name for name in sorted(masks) if name in cameras and (masks[name] > THRESHOLD).any()]
    if len(names) < 3:
        return
    from stages.masks.hull_check import check_masks_agree

    small = [shrunk(masks[name], cameras[name]) for name in names]
    agreement = check_masks_agree([mask for mask, _ in small], [camera for _, camera in small])
    if agreement is None:
        return
    for name, found in zip(names, agreement):
        views[name].update(hull_excess=found.excess, hull_blame=found.blame, suspicious=found.suspicious)
    flagged = [name for name, found in zip(names, agreement) if found.suspicious]
    # A flag is only worth a line where most masks agree: else the cameras or the object's stillness are at fault.
    if flagged and len(flagged) <= len(names) // 2:
        stage.warn(
            f"{stage.capture.root}: masks that disagree with the visual hull of the others: {some(flagged)}; look at them"
        )
    elif flagged:
        stage.warn(f"{stage.capture.root}: most masks disagree with each other: are cameras and masks of the same views?")


def refuse_two_worlds(stage: StageRun, masks: dict[str, NDArray[np.uint8]]) -> None:
    """Raise UserError where two physical cameras have poses of two worlds: each one's masks agree, not with the other's."""
    from stages.masks.segment import cameras_of

    if stage.capture.kind != "multiview" or len(stage.capture.camera_names) < 2:
        return
    from stages.masks.worlds import other_world

    cameras = cameras_of(stage)
    names = [name for name in sorted(masks) if name in cameras and (masks[name] > THRESHOLD).any()]
    small = [shrunk(masks[name], cameras[name]) for name in names]
    pair = other_world([mask for mask, _ in small], [camera for _, camera in small])
    if pair is not None:
        raise UserError(stage.capture.root, f"the masks of {pair[0]} and {pair[1]} have no common hull", ONE_WORLD)


CONTOUR_VIEWS = 12


def say_if_frame_looks_wrong(stage: StageRun, masks: dict[str, NDArray[np.uint8]]) -> None:
    """Hold the Stokes frame against the object's outline; a line where it looks turned or mirrored."""
    from stages.masks.contour_check import contour_evidence, verdict

    names = sorted(masks)[:: max(1, len(masks) // CONTOUR_VIEWS)]
    folder = frames_folder(stage.inputs) / "frames"
    stokes = [read_stokes(folder / f"{name}.exr").mean(-1) for name in names]
    evidence = contour_evidence(stokes, [masks[name] > THRESHOLD for name in names])
    stage.note(
        "outline_agreement", {"as_is": abs(evidence.as_is), "s2_flipped": abs(evidence.flipped), "pixels": evidence.pixels}
    )
    line = verdict(evidence)
    if line:
        stage.warn(f"{stage.capture.root}: {line}")


def shrunk(mask: NDArray[np.uint8], camera: Camera) -> tuple[NDArray[np.bool_], Camera]:
    """Mask and camera at a size that the check's voxels resolve."""
    step = max(1, round(max(mask.shape) / CHECK_SIZE))
    part = mask[: mask.shape[0] // step * step, : mask.shape[1] // step * step]
    small = part.reshape(part.shape[0] // step, step, -1, step).mean((1, 3)) > THRESHOLD
    return small, camera.resized(small.shape[1], small.shape[0]) if step > 1 else camera


def given_mask(path: Path) -> NDArray[np.uint8]:
    """A given mask's first channel as 8 bits [H, W]. Raises UserError."""
    return np.round(np.clip(read_image(path)[..., 0], 0, 1) * 255).astype(np.uint8)


def rig_mask(path: Path) -> NDArray[np.uint8]:
    """The mask of a light stage's camera, of which each counts. Raises UserError if it is all black."""
    mask = given_mask(path)
    if not (mask > THRESHOLD).any():
        raise UserError(
            path, "the mask is all black: no object in this view", "mend it, or remove it to have the view segmented"
        )
    return mask


def light_stage_masks(stage: StageRun, method: str) -> dict[str, tuple[NDArray[np.uint8], str]]:
    """One mask per camera: its mask file, else a matte from its frames."""
    light_stage = stage.capture.light_stage
    assert light_stage is not None
    out = {}
    for name, camera in sorted(light_stage.cameras.items()):
        if method == "none":
            out[name] = np.full((camera.camera.height, camera.camera.width), 255, np.uint8), "none"
        elif camera.mask is not None and method != "matte":
            out[name] = rig_mask(camera.mask), "given"
        else:
            from stages.masks.matte import light_stage_matte

            out[name] = light_stage_matte(camera, stage), "matte"
    return out


def multiview_masks(stage: StageRun, method: str) -> dict[str, tuple[NDArray[np.uint8], str]]:
    """One mask per view, in the frames' geometry (pipeline.geometry.lens); what the method leaves out is segmented."""
    frames, bent = frame_table(stage.inputs), lenses(stage.inputs)
    out: dict[str, tuple[NDArray[np.uint8], str]] = {}
    if method == "none":
        return {v: (np.full((f["height"], f["width"]), 255, np.uint8), "none") for v, f in frames.items()}
    if method == "given":
        given = stage.capture.masks if isinstance(stage.capture.masks, dict) else {}
        for view, path in given.items():
            mask = given_mask(path)
            out[view] = bent[view].mask(mask) if view in bent else mask, "given"
    elif method == "alpha":
        for view, frame in frames.items():
            if frame["alpha"]:
                out[view] = given_mask(frames_folder(stage.inputs) / frame["alpha"]), "alpha"
    missing = [view for view in frames if view not in out]
    if missing:
        from stages.masks.segment import segment_views

        used = method if method not in ("given", "alpha") else "background"
        for view, mask in segment_views(stage, missing, used, known=out).items():
            out[view] = mask, used
    return out
