"""What finished masks say of each other and of the cameras: other worlds, wrong cameras, single wrong masks."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.capture.naming.files import some
from pipeline.engine.stage import StageRun
from pipeline.errors import UserError
from pipeline.formats.given_mask import THRESHOLD
from pipeline.geometry.cameras import Camera
from pipeline.geometry.separate_worlds import ONE_WORLD

GIVEN = ("given", "alpha")
"""Methods whose masks are the capture's own."""
CHECK_SIZE = 240
"""Pixels of the longer side at which masks are held against a hull of voxels."""


def say_if_masks_disagree(stage: StageRun, masks: Mapping[str, NDArray[np.uint8]], views: Mapping[str, dict[str, Any]]) -> None:
    """Hold masks against each other and against the cameras; a line where they do not fit.

    Args:
        stage: the run.
        masks: by view, 0..255. [H, W] each
        views: the facts of each mask, which are added to.

    Raises:
        UserError: two physical cameras have poses of two worlds.
    """
    from stages.masks.inputs import cameras_of

    cameras = cameras_of(stage)
    names = [name for name in sorted(masks) if name in cameras and (masks[name] > THRESHOLD).any()]
    if not names:
        return
    small = {name: shrunk(masks[name], cameras[name]) for name in names}
    _refuse_two_worlds(stage, small)
    said = stage.parameters.hull_check and _say_if_cameras_do_not_fit(stage, masks, cameras, views)
    if stage.parameters.hull_check and len(names) >= 3:
        _flag_disagreement(stage, small, views, said)


def _refuse_two_worlds(stage: StageRun, small: Mapping[str, tuple[NDArray[np.bool_], Camera]]) -> None:
    """Each physical camera's masks agree, but not with the other's."""
    if len(stage.capture.camera_names) < 2:
        return
    from stages.masks.worlds import other_world

    pair = other_world([mask for mask, _ in small.values()], [camera for _, camera in small.values()])
    if pair is not None:
        raise UserError(stage.capture.root, f"the masks of {pair[0]} and {pair[1]} have no common hull", ONE_WORLD)


def _say_if_cameras_do_not_fit(
    stage: StageRun, masks: Mapping[str, NDArray[np.uint8]], cameras: Mapping[str, Camera], views: Mapping[str, dict[str, Any]]
) -> bool:
    """Whether the capture's own masks, or else its pictures, show what is wrong with its own cameras; a line if so."""
    if stage.capture.cameras is None:
        return False
    from stages.masks.outline_check import outline_doubt

    given = {name: masks[name] > THRESHOLD for name in masks if views[name]["method"] in GIVEN}
    found = outline_doubt(cameras, given)
    if found is None:
        return say_if_pictures_do_not_fit(stage, given)
    stage.warn(f"{stage.capture.camera_file}: {found}")
    return True


def say_if_pictures_do_not_fit(stage: StageRun, masks: Mapping[str, NDArray[np.bool_]]) -> bool:
    """Hold the capture's own cameras against points that its pictures share; a line where they do not fit.

    Args:
        stage: the run.
        masks: True where to look, by view; views without one are looked at all over. [H, W] each

    Returns:
        Whether there was a line.
    """
    from stages.masks.inputs import cameras_of, frame_s0
    from stages.masks.picture_check import picture_doubt

    if stage.capture.cameras is None:
        return False
    found = picture_doubt(cameras_of(stage), lambda view: frame_s0(stage, view).mean(-1), masks)
    if found is not None:
        stage.warn(f"{stage.capture.camera_file}: {found}")
    return found is not None


def _flag_disagreement(
    stage: StageRun, small: Mapping[str, tuple[NDArray[np.bool_], Camera]], views: Mapping[str, dict[str, Any]], said: bool
) -> None:
    """Masks against the visual hull of the others; lines only where the reason is not said already."""
    from stages.masks.hull_check import check_masks_agree

    names = list(small)
    agreement = check_masks_agree([mask for mask, _ in small.values()], [camera for _, camera in small.values()])
    if agreement is None:
        return
    for name, found in zip(names, agreement):
        views[name].update(hull_excess=found.excess, hull_blame=found.blame, suspicious=found.suspicious)
    flagged = [name for name, found in zip(names, agreement) if found.suspicious]
    if said:
        return
    # A flag is only worth a line where most masks agree: else the cameras or the object's stillness are at fault.
    if flagged and len(flagged) <= len(names) // 2:
        stage.warn(
            f"{stage.capture.root}: masks that disagree with the visual hull of the others: {some(flagged)}; look at them"
        )
    elif flagged and all(views[name]["method"] in GIVEN for name in flagged):
        stage.warn(
            f"{stage.capture.root}: most masks disagree with each other: check that cameras and masks are of the same views, "
            "and which pose belongs to which picture"
        )


def shrunk(mask: NDArray[np.uint8], camera: Camera) -> tuple[NDArray[np.bool_], Camera]:
    """Reduce a mask and its camera to a size that the voxels of the hull check resolve.

    Args:
        mask: 0..255. [H, W]
        camera: of this size.

    Returns:
        The mask, True inside, and the camera, a whole factor smaller.
    """
    step = max(1, round(max(mask.shape) / CHECK_SIZE))
    part = mask[: mask.shape[0] // step * step, : mask.shape[1] // step * step]
    small = part.reshape(part.shape[0] // step, step, -1, step).mean((1, 3)) > THRESHOLD
    return small, camera.resized(small.shape[1], small.shape[0]) if step > 1 else camera
