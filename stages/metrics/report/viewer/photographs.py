"""The captured cameras and their photographs, small enough for a page."""

from __future__ import annotations

import base64
import io
import json
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.engine.stage import StageRun
from pipeline.formats import dataset_files as files
from pipeline.formats.images import RGB, S0, channel_names, read_image
from pipeline.geometry.cameras import Camera, load_cameras
from pipeline.geometry.lens import frames_folder
from pipeline.report.pictures import evenly_chosen, exposure_of, fit, radiance

LONGEST = 512  # px of a photograph's longer side
QUALITY = 85
BUDGET = 4_000_000  # bytes of all photographs; beyond it they get smaller
MOST = 200  # cameras that anybody steps through


def camera_entries(run: StageRun, turn: NDArray[np.float64]) -> tuple[list[dict[str, Any]], float]:
    """The views' cameras with their photographs, and the factor to display white that these were stored with.

    A camera: `size`, `focal` and `middle` in px, `rotation` [3][3] and `translation` of OpenCV's world-to-camera from the
    y-up frame, `test`, `angle` of its polariser in degrees (null: none), `picture` as a data: URI. `turn` [3, 3]: to y up.
    """
    cameras = {v: c for v, c in load_cameras(run.inputs["poses"] / files.CAMERAS).items() if c.is_pinhole}
    folder = frames_folder(run.inputs)
    names = evenly_chosen([v for v in sorted(cameras) if files.frame(folder, v).is_file()], MOST)
    if not names:
        return [], 1.0
    gain = exposure_of(_photograph(run, names[0]))
    angles = _angles(run, cameras)
    held_back = set(files.held_back_views(run.inputs["train"]))
    longest, pictures = LONGEST, _jpegs(run, names, gain, LONGEST)
    total = sum(map(len, pictures))
    if total > BUDGET:
        longest = int(LONGEST * np.sqrt(BUDGET / total))
        pictures = _jpegs(run, names, gain, longest)
    return [
        {
            "name": view, "test": view in held_back, "angle": angles.get(view), **_pose(cameras[view], turn),
            "picture": "data:image/jpeg;base64," + base64.b64encode(data).decode(),
        }
        for view, data in zip(names, pictures)
    ], gain  # fmt: skip


def _pose(camera: Camera, turn: NDArray[np.float64]) -> dict[str, Any]:
    return {
        "size": [camera.width, camera.height], "focal": [camera.fx, camera.fy], "middle": [camera.cx, camera.cy],
        "rotation": (camera.world_to_camera[:3, :3] @ turn.T).tolist(),
        "translation": camera.world_to_camera[:3, 3].tolist(),
    }  # fmt: skip


def _angles(run: StageRun, cameras: dict[str, Camera]) -> dict[str, float]:
    """Transmission axis of each view's polariser in degrees, where it stood behind one."""
    if run.capture.polarisation != "polarisers":
        return {}
    path = run.inputs["train"] / files.POLARISERS
    known = json.loads(path.read_text()) if path.is_file() else {}
    return {v: float(known[c.name]["angle_deg"]) for v, c in cameras.items() if c.name in known}


def _photograph(run: StageRun, view: str) -> NDArray[np.float32]:
    """Linear RGB [H, W, 3], black outside the mask."""
    path = files.frame(frames_folder(run.inputs), view)
    image = np.nan_to_num(read_image(path, S0 if "S0.R" in channel_names(path) else RGB))
    mask = files.mask(run.inputs["masks"], view) if "masks" in run.inputs else None
    if mask is not None and mask.exists():
        inside = read_image(mask)[..., 0]
        if inside.shape == image.shape[:2]:
            image = image * (inside > 0.5)[..., None]
    return image


def _jpegs(run: StageRun, names: Sequence[str], gain: float, longest: int) -> list[bytes]:
    from PIL import Image

    out = []
    for view in names:
        stream = io.BytesIO()
        Image.fromarray(fit(radiance(_photograph(run, view), gain), longest)).save(stream, "JPEG", quality=QUALITY)
        out.append(stream.getvalue())
    return out
