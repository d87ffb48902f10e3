"""PhyGaP's Mitsuba renders: images_full/NNN.exr with Stokes channels, masks/, camera_params.npz."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from pipeline.capture.config import CaptureConfig
from pipeline.capture.layouts import Layout
from pipeline.capture.model import Capture, ViewSource
from pipeline.capture.naming.files import count, find_environments, list_images, some, sorted_views
from pipeline.capture.naming.masks import check_masks, find_masks
from pipeline.capture.pixels.stokes_files import stokes_exr_loader
from pipeline.errors import UserError
from pipeline.formats.arrays import read_arrays
from pipeline.formats.images import image_size
from pipeline.geometry.camera_check import check_camera
from pipeline.geometry.cameras import Camera

FOLDER, PARAMETERS = "images_full", "camera_params.npz"


def recognise(root: Path) -> bool:
    return (root / FOLDER).is_dir() and (root / PARAMETERS).exists()


def read(root: Path, config: CaptureConfig) -> Capture:
    """Open the capture; extrinsics are world-to-camera (OpenCV), one per image in the order of the names."""
    folder = root / FOLDER
    images = list_images(folder, {".exr"})
    if not images:
        raise UserError(folder, "holds no EXR image", "render or copy the images into it")
    table = load_parameters(root / PARAMETERS)
    extrinsics, warnings = table["extrinsics"], []
    chosen = list(range(len(images)))
    if len(extrinsics) != len(images):
        # Numbered images name their camera; anything else has to match one to one.
        numbers = [int(p.stem) if p.stem.isdigit() else -1 for p in images]
        if min(numbers) < 0 or len(set(numbers)) != len(numbers):
            raise UserError(
                root / PARAMETERS,
                f"holds {count(extrinsics, 'camera')} for {count(images, 'image')}",
                "give each image its camera",
            )
        stray = [p.name for p, n in zip(images, numbers) if n >= len(extrinsics)]
        if stray:
            warnings.append(f"{folder}: no camera for {some(stray)}; left out: check its number against {PARAMETERS}")
        lonely = [f"{n:03d}" for n in range(len(extrinsics)) if n not in numbers]
        if lonely:
            missing = f"no image for {count(lonely, 'camera')} ({some(lonely)})"
            warnings.append(f"{root / PARAMETERS}: {missing}; left out: check the numbers of the images")
        kept = [(p, n) for p, n in zip(images, numbers) if n < len(extrinsics)]
        if not kept:
            raise UserError(root / PARAMETERS, "no image has a camera", "number the images from 000")
        images, chosen = [p for p, _ in kept], [n for _, n in kept]
    cameras, views = {}, []
    for path, index in zip(images, chosen):
        k = table["intrinsics"][index] if table["intrinsics"].ndim == 3 else table["intrinsics"]
        size = image_size(path)
        want = (int(table["image_width"]), int(table["image_height"]))
        if size != want:
            raise UserError(
                path, f"is {size[0]}x{size[1]}, {PARAMETERS} says {want[0]}x{want[1]}", "render it again in that size"
            )
        camera = Camera(*size, float(k[0, 0]), float(k[1, 1]), float(k[0, 2]), float(k[1, 2]), extrinsics[index])
        cameras[path.stem] = check_camera(camera, root / PARAMETERS, f"camera {index}")
        views.append(ViewSource(path.stem, (path,), "camera", stokes_exr_loader(path, config), size))
    by_view = {v.view: v.paths[0] for v in views}
    masks, more = find_masks(root, by_view, folder)
    check_masks(masks, lambda view: (cameras[view].width, cameras[view].height))
    environments = find_environments(root)
    return Capture(
        root, "phygap_mitsuba", "multiview", "stokes", sorted_views(views), environments=environments, config=config,
        up=config.up or "y", cameras=cameras, masks=masks or None, warnings=tuple(warnings + more),
        files=(root / PARAMETERS, *images, *masks.values(), *environments),
    )  # fmt: skip


def load_parameters(path: Path) -> dict[str, np.ndarray]:
    """The arrays of camera_params.npz, checked. Raises UserError."""
    wanted = ("intrinsics", "extrinsics", "image_width", "image_height")
    table = read_arrays(path, lambda name: name in wanted)
    missing = [k for k in wanted if k not in table]
    if missing:
        raise UserError(path, f"has no {', '.join(missing)}", "write the file as PhyGaP's renderer does")
    extrinsics = table["extrinsics"]
    if extrinsics.ndim != 3 or extrinsics.shape[1:] not in ((4, 4), (3, 4)):
        raise UserError(
            path, f"extrinsics have the shape {extrinsics.shape}, not (views, 4, 4)", "write world-to-camera matrices"
        )
    shape = table["intrinsics"].shape
    if shape != (3, 3) and shape != (len(extrinsics), 3, 3):
        fault = f"intrinsics have the shape {shape}, not (3, 3) or ({len(extrinsics)}, 3, 3)"
        raise UserError(path, fault, "write pinhole matrices")
    if extrinsics.shape[1] == 3:
        bottom = np.broadcast_to([[[0.0, 0.0, 0.0, 1.0]]], (len(extrinsics), 1, 4))
        table["extrinsics"] = np.concatenate([extrinsics, bottom], axis=1)
    for k in ("image_width", "image_height"):
        if table[k].size != 1 or not np.isfinite(table[k]).all() or not float(table[k].ravel()[0]) > 0:
            raise UserError(path, f"{k} is not one number above 0", "write the image's size in pixels")
        table[k] = table[k].reshape(())
    return table


LAYOUT = Layout("phygap_mitsuba", "images_full/NNN.exr (S0.R ..) and camera_params.npz", recognise, read)
