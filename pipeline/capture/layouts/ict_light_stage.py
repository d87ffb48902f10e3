"""Light stages: `camNN/cross` and `camNN/parallel` frames, LSX3 tables or a `lights.csv`, `cameras/cameraNN.txt`.

Covers the layout published with ICTPolarReal (`LSX3_*.txt`) and any other rig with a `lights.csv`.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from pipeline.capture.config import CaptureConfig
from pipeline.capture.layouts import Layout
from pipeline.capture.model import Capture, LightStage, LightStageCamera, LightTable
from pipeline.errors import UserError
from pipeline.geometry.camera_check import check_camera
from pipeline.geometry.cameras import OPENGL_FROM_OPENCV, Camera
from pipeline.geometry.straight_camera import unreached

LEADING_FRAMES = 2  # a pass begins with two frames under all lights (tracking), then one frame a light
IMAGES = (".exr", ".hdr", ".png", ".tif", ".tiff")
PASSES = ("cross", "parallel")


def recognise(root: Path) -> bool:
    """A folder with a `camNN/` that holds a `cross/` or a `parallel/`."""
    return any(_camera_folders(root))


def read(root: Path, config: CaptureConfig) -> Capture:
    """Open a light-stage capture. Raises UserError naming the file at fault. Pixels are not read."""
    from pipeline.rig.tables import LSX3_POSITIONS, LSX3_SPIRAL, read_lights_csv, read_lsx3

    lsx3 = [root / LSX3_POSITIONS, root / LSX3_SPIRAL]
    table_path = root / (config.olat.lights or "lights.csv")
    if config.olat.lights is not None or table_path.is_file():
        lights, tables = read_lights_csv(table_path), [table_path]
    elif any(path.is_file() for path in lsx3):
        lights, tables = read_lsx3(root), lsx3
    else:
        raise UserError(root, "the frames have no light table", f"add lights.csv, or {LSX3_POSITIONS} and {LSX3_SPIRAL}")
    folders = _camera_folders(root)
    cameras = {folder.name: _camera(root, folder, lights, tables[-1], config) for folder in folders}
    files = [*tables, *sorted((root / "cameras").glob("*.txt"))]
    for camera in cameras.values():
        files += [*camera.cross, *camera.parallel, *([camera.mask] if camera.mask else [])]
    files += [root / "capture.toml"] if config.path is not None else []
    environments = sorted(p for p in (root / "envmaps").glob("*") if p.suffix.lower() in (".hdr", ".exr"))
    facts: list[str] = []
    extra = {len(camera.full_light) for camera in cameras.values()} - {0}
    if extra:
        facts.append(f"{max(extra)} frames a pass beside the lights' own (all lights on, or dark) are left out")
    return Capture(
        root=root,
        layout="ict_light_stage" if tables == lsx3 else "light_stage",
        kind="light_stage",
        polarisation="polarisers",
        light_stage=LightStage(root, cameras, lights),
        environments=tuple(environments),
        config=config,
        up=config.up or "y",
        cameras={name: camera.camera for name, camera in cameras.items()},
        masks={name: camera.mask for name, camera in cameras.items() if camera.mask is not None} or None,
        files=tuple([*files, *environments]),
        facts=tuple(facts),
    )


def _camera_folders(root: Path) -> list[Path]:
    folders = sorted(p for p in root.glob("cam[0-9]*") if p.is_dir())
    return [p for p in folders if any((p / name).is_dir() for name in PASSES)]


def _camera(root: Path, folder: Path, lights: LightTable, table: Path, config: CaptureConfig) -> LightStageCamera:
    from pipeline.formats.images import image_size

    passes = {}
    for name in PASSES:
        if not (folder / name).is_dir():
            raise UserError(
                folder / name, "is missing: a camera needs both passes", "add the frames, or remove the camera's folder"
            )
        passes[name] = light_frames(folder / name, len(lights), table)
    sizes = {name: image_size(frames[0][0]) for name, frames in passes.items()}
    if sizes["cross"] != sizes["parallel"]:
        fault = f"is {sizes['parallel']} pixels, the cross pass {sizes['cross']}"
        raise UserError(passes["parallel"][0][0], fault, "export both passes at one size")
    mask = next((p for p in (folder / "mask.png", folder / "mask.exr", folder / "mask.jpg") if p.is_file()), None)
    if mask is not None and image_size(mask) != sizes["cross"]:
        raise UserError(mask, f"is {image_size(mask)} pixels, the frames {sizes['cross']}", "make the mask at the frames' size")
    number = int(re.sub(r"\D", "", folder.name))
    path = root / "cameras" / f"camera{number:02d}.txt"
    if not path.is_file():
        raise UserError(path, f"{folder.name} has images but no camera file", "add it, or remove the folder")
    camera = read_camera(path, *sizes["cross"], name=folder.name, distortion=config.olat.distortion)
    return LightStageCamera(folder.name, passes["cross"][0], passes["parallel"][0], mask, camera, passes["cross"][1])


def light_frames(folder: Path, lights: int, table: Path) -> tuple[tuple[Path, ...], tuple[Path, ...]]:
    """The frames of `folder` in the order of the lights, and the frames that belong to no light.

    Frame numbers 2..N+1 (of N+4: two leading frames under all lights, two trailing) or 0..N-1 are light 0..N-1. A pass that
    begins at 0 is whole or has no leading frames: a table that is a few rows short must not shift the lights by two.
    Raises UserError when frames are missing, empty, or their number does not fit the table.
    """
    found: dict[int, Path] = {}
    for path in sorted(p for p in folder.iterdir() if p.suffix.lower() in IMAGES and not p.name.startswith(".")):
        digits = re.findall(r"\d+", path.stem)
        if not digits:
            raise UserError(path, "has no frame number in its name", "name frames by number, as 000002.exr")
        if int(digits[-1]) in found:
            raise UserError(path, f"has the same frame number as {found[int(digits[-1])].name}", "keep one of the two")
        found[int(digits[-1])] = path
    if not found:
        raise UserError(folder, "holds no frame", "add the frames, or remove the camera's folder")
    last = max(found)
    if min(found) == 0 and last == lights - 1:
        first = 0
    elif last == lights + 2 * LEADING_FRAMES - 1 or (
        min(found) > 0 and lights + LEADING_FRAMES - 1 <= last < lights + 2 * LEADING_FRAMES
    ):
        first = LEADING_FRAMES
    elif min(found) == 1 and last == lights:
        first = 1
    else:
        fault = f"lists {lights} lights, but {folder} has frames {min(found)}..{last} ({len(found)} files)"
        raise UserError(
            table, fault, "frames 0..N-1 or 2..N+1 belong to N lights: use the table that fits, or the other frames"
        )
    missing = [k for k in range(first, first + lights) if k not in found]
    if missing:
        named = ", ".join(str(k) for k in missing[:5]) + (f" and {len(missing) - 5} more" if len(missing) > 5 else "")
        raise UserError(folder, f"lacks frame {named} of {lights} lights", "copy the missing frames")
    empty = next((found[k] for k in range(first, first + lights) if found[k].stat().st_size == 0), None)
    if empty is not None:
        raise UserError(empty, "the file is empty (0 bytes)", "copy it again from its source")
    frames = tuple(found[k] for k in range(first, first + lights))
    return frames, tuple(path for k, path in sorted(found.items()) if not first <= k < first + lights)


def read_camera(path: Path, width: int, height: int, name: str = "camera", distortion: bool = False) -> Camera:
    """An LSX3 camera file: camera-to-world with OpenGL axes, intrinsics of the full frame.

    A smaller image is that frame scaled by height, square pixels, centred. `distortion` applies the file's k1 k2 p1 p2.
    Raises UserError when a block is missing or malformed.
    """
    lines = path.read_text(errors="replace").splitlines()

    def block(title: str, rows: int, columns: int) -> np.ndarray:
        at = next((i for i, line in enumerate(lines) if line.strip().lower().startswith(title)), None)
        try:
            if at is None:
                raise ValueError
            table = np.array([[float(cell) for cell in line.split()] for line in lines[at + 1 : at + 1 + rows]])
            if table.shape != (rows, columns) or not np.isfinite(table).all():
                raise ValueError
        except ValueError:
            fault = f"has no {rows}x{columns} numbers under {title!r}"
            raise UserError(path, fault, "use the camera files as published") from None
        return table

    focal, centre, full = (block(title, 1, 2)[0] for title in ("#focal", "#principal", "#resolution"))
    world_from_gl = block("matrix", 4, 4)
    if focal.min() <= 0 or full.min() <= 0:
        raise UserError(path, f"focal length {focal.tolist()} or resolution {full.tolist()} is not above 0", "mend it")
    if np.linalg.matrix_rank(world_from_gl) < 4:
        raise UserError(path, "its matrix holds no rotation", "give camera-to-world, OpenGL axes, row by row")
    scale = height / full[1]
    coefficients = tuple(block("#distortion", 1, 4)[0]) if distortion else ()
    camera = Camera(
        width=width,
        height=height,
        fx=focal[0] * scale,
        fy=focal[1] * scale,
        cx=width / 2 + (centre[0] - full[0] / 2) * scale,
        cy=height / 2 + (centre[1] - full[1] / 2) * scale,
        world_to_camera=np.linalg.inv(world_from_gl @ OPENGL_FROM_OPENCV),
        distortion=coefficients,
        name=name,
    )
    if unreached(check_camera(camera, path, name)) > 0:
        fault = f"its distortion ({', '.join(f'{k:g}' for k in coefficients)}) folds within the image"
        raise UserError(path, fault, "check the coefficients, or set olat.distortion = false")
    return camera


LAYOUT = Layout(
    name="ict_light_stage",
    looks_like="camNN/cross and camNN/parallel frames, cameras/cameraNN.txt, LSX3_light_*.txt or lights.csv",
    recognise=recognise,
    read=read,
)
