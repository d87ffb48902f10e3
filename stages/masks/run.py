"""Make the masks of a capture by the chosen method, check them, and write them."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.capture.naming.files import count, some
from pipeline.engine.stage import StageRun
from pipeline.errors import UserError
from pipeline.formats.dataset_files import MASKS
from pipeline.formats.given_mask import THRESHOLD, GivenMask, read_given
from pipeline.formats.images import read_stokes, write_png
from pipeline.geometry.lens import frame_table, frames_folder, lenses
from stages.masks.agreement import GIVEN, say_if_masks_disagree
from stages.masks.parameters import choose_method


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
    if stage.capture.kind == "multiview":
        say_if_masks_disagree(stage, pixels, views)
        say_if_one_sided(stage)
        say_if_segmentation_failed(stage, pixels, methods)
    if stage.capture.polarisation == "stokes":
        say_if_frame_looks_wrong(stage, pixels)
    say_if_inverted(stage, pixels, methods)
    empty = [name for name in sorted(views) if views[name]["coverage"] == 0]
    if len(empty) == len(views):
        raise UserError(stage.capture.root, "no view shows the object: every mask is empty", "give masks/, white on the object")
    if empty:
        stage.warn(
            f"{stage.capture.root}: the mask is empty in {count(empty, 'view')} ({some(empty)}), which nothing is learnt from: "
            "look at the masks"
        )
    table = {"schema": 1, "method": method, "reason": reason, "views": views}
    (stage.output / MASKS).write_text(json.dumps(table, indent=1) + "\n", encoding="utf-8")


def say_if_one_sided(stage: StageRun) -> None:
    """A line where the cameras do not go around the object, or leave a side of it unseen.

    Args:
        stage: the run whose cameras are looked at.
    """
    from stages.masks.doubts import one_sided
    from stages.masks.inputs import cameras_of
    from stages.masks.unseen_side import unseen_side

    cameras = cameras_of(stage)
    fault = one_sided([cameras[view] for view in sorted(cameras)])
    unseen = unseen_side(cameras) if fault is None and not stage.partial else None
    if fault is not None:
        stage.warn(
            f"{stage.capture.root}: {fault}: outlines bound no depth and the far side is not seen, so the shape is a guess "
            "there; check that no views of that side are missing"
        )
    if unseen is not None:
        stage.note("unseen_side", unseen.as_json())
        stage.warn(
            f"{stage.capture.root}: {unseen.said(stage.capture.up)}: no outline bounds the shape and no picture shows the "
            "material; check that no views are missing, or take some of that side too"
        )


def say_if_segmentation_failed(stage: StageRun, masks: dict[str, NDArray[np.uint8]], methods: dict[str, str]) -> None:
    """A line where most of the masks made here cannot be one object's."""
    from stages.masks.doubts import segmentation_faults

    made = [name for name in sorted(masks) if methods[name] not in (*GIVEN, "none")]
    faults = segmentation_faults([masks[name] > THRESHOLD for name in made])
    if faults:
        stage.warn(
            f"{stage.capture.root}: the object could not be told from the scene ({'; '.join(faults)}): give masks in masks/, "
            "named like the views and white on the object"
        )


def say_if_inverted(stage: StageRun, masks: dict[str, NDArray[np.uint8]], methods: dict[str, str]) -> None:
    """A line where most of the given masks are white on the background."""
    from stages.masks.doubts import MOST, inverted

    given = [name for name in sorted(masks) if methods[name] in GIVEN]
    found = inverted([masks[name] > THRESHOLD for name in given])
    if found > MOST * len(given):
        stage.warn(
            f"{stage.capture.root}: {found} of {len(given)} masks are white all around and black in the middle: white must be "
            "the object; invert them"
        )


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


def given_masks(stage: StageRun, paths: Mapping[str, Path], what: str) -> dict[str, NDArray[np.uint8]]:
    """Masks 0..255 by name from files, without those that are white all over; says what was made of them.

    what: "masks" or "alpha", for the user.
    """
    found = {name: read_given(path) for name, path in sorted(paths.items())}
    _say_readings(stage, paths, found)
    whole = [name for name, mask in found.items() if mask.whole]
    if whole and what == "alpha":  # cameras and editors write such alpha by themselves: nothing to mend
        stage.progress.say(f"the alpha of {count(whole, 'image')} is opaque all over and no mask: these are segmented")
    elif whole:
        stage.warn(
            f"{paths[whole[0]]}: {count(whole, 'mask')} white all over ({some(whole)}), which tells no object from anything: "
            "these are segmented; mend them, or take the whole frame with masks.method=none"
        )
    return {name: mask.pixels for name, mask in found.items() if not mask.whole}


def _say_readings(stage: StageRun, paths: Mapping[str, Path], found: Mapping[str, GivenMask]) -> None:
    """One line for each way in which masks were read that is not the plain one."""
    readings: dict[str, list[str]] = {}
    for name, mask in found.items():
        if mask.reading is not None:
            readings.setdefault(mask.reading, []).append(name)
    for reading, names in readings.items():
        more = f" and {count(names[1:], 'more mask')}" if len(names) > 1 else ""
        stage.progress.say(f"{paths[names[0]]}{more}: {reading}")
    if readings:
        stage.note("masks_read", {reading: len(names) for reading, names in readings.items()})


def light_stage_masks(stage: StageRun, method: str) -> dict[str, tuple[NDArray[np.uint8], str]]:
    """One mask per camera: its mask file, else a matte from its frames."""
    light_stage = stage.capture.light_stage
    assert light_stage is not None
    files = {name: camera.mask for name, camera in light_stage.cameras.items() if camera.mask is not None}
    given = given_masks(stage, files, "masks") if method not in ("none", "matte") else {}
    out = {}
    for name, camera in sorted(light_stage.cameras.items()):
        if method == "none":
            out[name] = np.full((camera.camera.height, camera.camera.width), 255, np.uint8), "none"
        elif name in given:
            out[name] = given[name], "given"
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
        for view, mask in given_masks(stage, given, "masks").items():
            out[view] = bent[view].mask(mask) if view in bent else mask, "given"
    elif method == "alpha":
        folder = frames_folder(stage.inputs)
        alphas = {view: folder / frame["alpha"] for view, frame in frames.items() if frame["alpha"]}
        out = {view: (mask, "alpha") for view, mask in given_masks(stage, alphas, "alpha").items()}
    missing = [view for view in frames if view not in out]
    if missing:
        from stages.masks.segment import segment_views

        used = method if method not in ("given", "alpha") else "background"
        for view, mask in segment_views(stage, missing, used, known=out).items():
            out[view] = mask, used
    return out
