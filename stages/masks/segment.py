"""Segment views without masks by one of the methods."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pipeline.engine.stage import StageRun
from pipeline.geometry.cameras import Camera
from stages.masks.inputs import cameras_of, frame_s0

MIN_VIEWS = 4
"""Below this the views' agreement says little: each is segmented on its own."""


def segment_views(
    stage: StageRun, missing: list[str], method: str, known: dict[str, tuple[NDArray[np.uint8], str]]
) -> dict[str, NDArray[np.uint8]]:
    """Masks 0/255 by VIEW for the `missing` views; `known` ones help. Raises UserError where a method lacks its input."""
    cameras = cameras_of(stage)
    if method == "clean_plate":
        from stages.masks.clean_plate import by_clean_plate

        masks = by_clean_plate(stage, missing)
    elif method == "sam":
        from stages.masks.sam import by_sam

        masks = by_sam(stage, missing, cameras)
    else:
        masks = by_background(stage, missing, known, cameras)
    return {view: mask.astype(np.uint8) * np.uint8(255) for view, mask in masks.items()}


def by_background(
    stage: StageRun, missing: list[str], known: dict[str, tuple[NDArray[np.uint8], str]], cameras: dict[str, Camera]
) -> dict[str, NDArray[np.bool_]]:
    """All views together where cameras are known, else each by GrabCut from its centre."""
    views = [v for v in sorted({*missing, *known}) if v in cameras]
    if len(views) >= MIN_VIEWS:
        from stages.masks.background import segment

        images = [frame_s0(stage, view) for view in views]
        given = {i: known[view][0] > 127 for i, view in enumerate(views) if view in known}
        masks = segment(images, [cameras[v] for v in views], given, stage.parameters.max_size)
        if masks is not None:
            found = {view: mask for view, mask in zip(views, masks) if view in missing}
            rest = [v for v in missing if v not in found]
            return {**found, **_one_by_one(stage, rest)} if rest else found
    return _one_by_one(stage, missing)


def _one_by_one(stage: StageRun, views: list[str]) -> dict[str, NDArray[np.bool_]]:
    from stages.masks.grabcut import grabcut_centre

    stage.warn(
        f"{stage.capture.root}: too few views with cameras that look at one thing; masks are guessed from each view alone: "
        "check them, or give masks in masks/"
    )
    return {view: grabcut_centre(frame_s0(stage, view)) for view in views}
