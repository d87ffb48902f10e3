"""Segment Anything (Kirillov et al. 2023) from a local checkpoint, prompted by what the cameras look at."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from pipeline.engine.stage import StageRun
from pipeline.errors import UserError
from pipeline.formats import dataset_files as files
from pipeline.formats.ply import Ply
from pipeline.geometry.cameras import Camera
from stages.masks.background import Fixation, fixation, tidy
from stages.masks.grabcut import display
from stages.masks.inputs import frame_s0

MEAN, STD = np.array([123.675, 116.28, 103.53], np.float32), np.array([58.395, 57.12, 57.375], np.float32)
"""ImageNet's, in 8-bit codes: what SAM was trained with."""
POINTS = 8
STRAY_PCT, BOX_ROOM = 2.0, 0.05
"""Of the points, left out at either side of a box; and what it is widened by, of its size."""


def by_sam(stage: StageRun, views: list[str], cameras: dict[str, Camera]) -> dict[str, NDArray[np.bool_]]:
    """Masks [H, W] of the views. Raises UserError when the checkpoint cannot be loaded."""
    model = load_sam(Path(stage.parameters.sam_checkpoint or ""))
    ball = fixation(list(cameras.values())) if len(cameras) > 1 else None
    cloud = _points(stage, ball)
    out = {}
    with stage.progress.bar("Segment Anything", len(views), "views") as bar:
        for view in views:
            image = display(frame_s0(stage, view))
            height, width = image.shape[:2]
            box = prompt_box(cameras.get(view), cloud, width, height) if stage.parameters.prompt == "box" else None
            points = prompt_points(cameras.get(view), cloud, ball, width, height) if box is None else None
            out[view] = tidy(segment_image(model, image, points, box))
            bar.advance()
    return out


def load_sam(folder: Path) -> Any:
    """A SamModel of transformers from a folder with config.json and weights. Raises UserError; never downloads."""
    try:
        from transformers import SamModel
    except ImportError:
        raise UserError("masks.method=sam", "needs the package transformers", "pip install transformers") from None
    if not (folder / "config.json").is_file():
        raise UserError(
            folder,
            "is no Segment-Anything checkpoint (no config.json)",
            "give the folder that save_pretrained wrote, e.g. of facebook/sam-vit-base",
        )
    try:
        return SamModel.from_pretrained(str(folder), local_files_only=True).eval()
    except (OSError, ValueError, RuntimeError) as error:
        raise UserError(folder, f"cannot be loaded ({str(error).splitlines()[0]})", "download the checkpoint again") from None


def prompt_points(
    camera: Camera | None, cloud: NDArray | None, ball: Fixation | None, width: int, height: int
) -> NDArray[np.float64]:
    """Pixels [n, 2] on the object: sparse points inside what the cameras look at, else its centre, else the image's."""
    pixels = _seen(camera, cloud, width, height)
    if len(pixels) >= POINTS:
        # The middle of the cloud: its fringe may be background.
        order = np.argsort(np.linalg.norm(pixels - np.median(pixels, 0), axis=-1), kind="stable")
        return pixels[order[: len(order) // 2 + 1][:: max(1, len(order) // 2 // POINTS)]][:POINTS]
    if camera is not None and ball is not None:
        pixel, depth = camera.project(ball.centre)
        if depth > 0 and 0 < pixel[0] < width and 0 < pixel[1] < height:
            return pixel[None]
    return np.array([[width / 2, height / 2]])


def prompt_box(camera: Camera | None, cloud: NDArray | None, width: int, height: int) -> NDArray[np.float64] | None:
    """(x0, y0, x1, y1) about the sparse points but for stray ones, pixels; None where there are too few."""
    pixels = _seen(camera, cloud, width, height)
    if len(pixels) < POINTS:
        return None
    low, high = np.percentile(pixels, [STRAY_PCT, 100 - STRAY_PCT], axis=0)
    room = BOX_ROOM * (high - low)  # features lie inside outlines
    return np.concatenate([np.maximum(low - room, 0), np.minimum(high + room, [width, height])])


def _seen(camera: Camera | None, cloud: NDArray | None, width: int, height: int) -> NDArray[np.float64]:
    """Pixels [n, 2] of the sparse points that lie in the image."""
    if camera is None or cloud is None or not len(cloud):
        return np.empty((0, 2))
    pixels, depth = camera.project(cloud)
    return pixels[(depth > 0) & (pixels > 0).all(-1) & (pixels < [width, height]).all(-1)]


def segment_image(model: Any, image: NDArray[np.uint8], points: NDArray | None, box: NDArray | None) -> NDArray[np.bool_]:
    """One mask [H, W] of an 8-bit image [H, W, 3] from points [n, 2] on the object or a box (x0, y0, x1, y1), pixels."""
    import torch

    size = int(model.config.vision_config.image_size)
    scale = size / max(image.shape[:2])
    height, width = round(image.shape[0] * scale), round(image.shape[1] * scale)
    small = (cv2.resize(image, (width, height), interpolation=cv2.INTER_LINEAR).astype(np.float32) - MEAN) / STD
    padded = np.zeros((size, size, 3), np.float32)
    padded[:height, :width] = small
    prompt: dict[str, Any] = {}
    if points is not None:
        prompt["input_points"] = torch.tensor(points * scale, dtype=torch.float32)[None, None]
        prompt["input_labels"] = torch.ones((1, 1, len(points)), dtype=torch.int64)
    if box is not None:
        prompt["input_boxes"] = torch.tensor(box * scale, dtype=torch.float32)[None, None]
    pixels = torch.from_numpy(padded).permute(2, 0, 1)[None]
    with torch.no_grad():
        found = model(pixel_values=pixels, multimask_output=True, **prompt)
        best = int(found.iou_scores[0, 0].argmax())
        logits = torch.nn.functional.interpolate(found.pred_masks[:, 0, best][None].float(), (size, size), mode="bilinear")
    whole = logits[0, 0, :height, :width].numpy()
    return cv2.resize(whole, (image.shape[1], image.shape[0]), interpolation=cv2.INTER_LINEAR) > 0


def _points(stage: StageRun, ball: Fixation | None) -> NDArray | None:
    """The sparse model's points inside the ball that the cameras look at."""
    path = stage.inputs.get("poses", Path("/nonexistent")) / files.POINTS
    if not path.is_file():
        return None
    cloud = Ply(path).vertices()
    return cloud if ball is None else cloud[np.linalg.norm(cloud - ball.centre, axis=-1) < ball.radius]
