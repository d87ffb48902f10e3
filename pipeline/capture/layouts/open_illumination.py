"""OpenIllumination: Lights/LIGHT/raw_undistorted/CAMERA.JPG, output/obj_masks, output/transforms_*.json, light_pos.npy.

No polarisers; each light has a folder, in which every camera has a picture. The positions are the dataset's, in its root.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.capture.config import CaptureConfig
from pipeline.capture.layouts import Layout
from pipeline.capture.light_stage.frames import one_pass_facts
from pipeline.capture.light_stage.read_light_table import light_table_file, read_light_table
from pipeline.capture.model import Capture, LightStage, LightStageCamera
from pipeline.capture.naming.files import IMAGE_SUFFIXES, find_environments, list_images, some
from pipeline.errors import UserError
from pipeline.formats.images import image_size
from pipeline.formats.json_file import read_json
from pipeline.geometry.cameras import Camera, camera_from_frame
from pipeline.rig.light_table import LightTable

LIGHTS, PICTURES, OUTPUT, MASKS, POSITIONS = "Lights", "raw_undistorted", "output", "obj_masks", "light_pos.npy"
TABLES = ("transforms_train.json", "transforms_test.json")
PATTERNS = set(range(1, 14))
"""Numbers of the folders where several lights shine at a time (the dataset's other half)."""


def recognise(root: Path) -> bool:
    """Numbered folders with raw_undistorted/ below Lights/."""
    return bool(light_folders(root))


def light_folders(root: Path) -> dict[int, Path]:
    """The folder of pictures of each light, by its number, ascending."""
    home = next((p for p in sorted(root.iterdir()) if p.name.lower() == LIGHTS.lower() and p.is_dir()), None)
    if home is None:
        return {}
    found = {int(p.name): p / PICTURES for p in home.iterdir() if p.name.isdigit() and (p / PICTURES).is_dir()}
    return dict(sorted(found.items()))


def read(root: Path, config: CaptureConfig) -> Capture:
    """Open the pictures under each light as a light stage of one pass. Raises UserError naming the file at fault."""
    folders = light_folders(root)
    if set(folders) == PATTERNS:
        fault = "holds the light patterns 001 to 013, each of many lights at a time"
        raise UserError(root / LIGHTS, fault, "give the object's folder of one light at a time (OLAT)")
    lights, table = _lights(root, config, list(folders))
    frames, tables = _frames(root)
    pictures = {light: {p.stem: p for p in list_images(folder, IMAGE_SUFFIXES)} for light, folder in folders.items()}
    known = sorted(set(frames) & set().union(*pictures.values()))
    if not known:
        raise UserError(tables[0], "names no camera that has a picture", f"name them as {LIGHTS}/000/{PICTURES}/NAME.JPG")
    cameras = {}
    for number, name in enumerate(known):
        lost = [light for light, there in pictures.items() if name not in there]
        if lost:
            fault = f"has no picture of camera {name}, others have"
            raise UserError(folders[lost[0]], fault, "copy it, or remove the camera's")
        shots = tuple(there[name] for there in pictures.values())
        label = f"cam{number:02d}"
        mask, camera = _mask(root, name, shots[0]), _camera(frames[name], shots[0], label)
        cameras[label] = LightStageCamera(label, shots, shots, mask, camera, (), "none")
    masks = {label: camera.mask for label, camera in cameras.items() if camera.mask is not None}
    files = [table, *tables, *(p for c in cameras.values() for p in c.cross), *masks.values()]
    files += [root / "capture.toml"] if config.path is not None else []
    environments = find_environments(root)
    named = some((f"{label} is {name}" for label, name in zip(cameras, known)), 80)
    return Capture(
        root=root, layout="open_illumination", kind="light_stage", polarisation="none",
        light_stage=LightStage(root, cameras, lights), environments=environments, config=config, up=config.up or "y",
        cameras={label: camera.camera for label, camera in cameras.items()}, masks=masks or None,
        files=tuple([*files, *environments]), facts=(*one_pass_facts(cameras), f"cameras in the order of their names: {named}"),
    )  # fmt: skip


def _lights(root: Path, config: CaptureConfig, numbers: list[int]) -> tuple[LightTable, Path]:
    """The lights that have a folder, in their order, and their table. Raises UserError."""
    own = root / POSITIONS
    if light_table_file(root, config) is None and not own.is_file():
        remedy = "copy it from the dataset's root, beside OLAT/, or give lights.csv"
        raise UserError(own, "is missing: where the lights are", remedy)
    if own.is_file() and config.olat.lights is None:
        config = replace(config, olat=replace(config.olat, lights=POSITIONS))
    lights, tables = read_light_table(root, config)
    index = np.arange(len(lights)) if lights.index is None else lights.index
    first = config.olat.first_frame
    if first is None:  # the dataset counts from 0
        first = int(0 not in numbers and max(numbers) == len(index))
    row = {int(k) + first: place for place, k in enumerate(index)}
    unknown = [n for n in numbers if n not in row]
    if unknown:
        fault = f"has no row for the light of folder {unknown[0]:03d} ({len(index)} rows)"
        raise UserError(tables[-1], fault, "use the table of this capture, or say first_frame under [olat] in capture.toml")
    rows = np.array([row[n] for n in numbers])
    colour = None if lights.colour is None else lights.colour[rows]
    area = None if lights.solid_angle is None or len(rows) < len(index) else lights.solid_angle[rows]
    directions, positions, intensity = lights.directions[rows], lights.positions[rows], lights.intensity[rows]
    return LightTable(directions, positions, intensity, area, index[rows], colour=colour), tables[-1]


def _frames(root: Path) -> tuple[dict[str, tuple[dict[str, Any], dict[str, Any], Path]], list[Path]]:
    """Entry, table and file of each camera's frame by its name, and the tables. Raises UserError."""
    tables = [p for name in TABLES for p in (root / OUTPUT / name,) if p.is_file()]
    if not tables:
        raise UserError(root / OUTPUT / TABLES[0], "is missing: the cameras", "copy the object's output/ beside Lights/")
    found = {}
    for path in tables:
        table = read_json(path)
        frames = table.get("frames") if isinstance(table, dict) else None
        if not isinstance(frames, dict) or not all(isinstance(entry, dict) for entry in frames.values()):
            remedy = 'it needs "frames": {NAME: {"camera_angle_x", "transform_matrix"}}'
            raise UserError(path, "holds no frames by camera", remedy)
        shared = {key: value for key, value in table.items() if key != "frames"}
        found |= {name: (entry, shared, path) for name, entry in frames.items()}
    return found, tables


def _camera(frame: tuple[dict[str, Any], dict[str, Any], Path], picture: Path, label: str) -> Camera:
    entry, shared, path = frame
    width, height = image_size(picture)
    own = {} if "w" in {**shared, **entry} else {"w": width, "h": height}
    return replace(camera_from_frame({"file_path": picture.name, **entry, **own}, shared, path), name=label)


def _mask(root: Path, name: str, picture: Path) -> Path | None:
    """output/obj_masks/NAME.png, if there is one. Raises UserError on another size than the picture's."""
    path = root / OUTPUT / MASKS / f"{name}.png"
    if not path.is_file():
        return None
    if image_size(path) != image_size(picture):
        raise UserError(path, f"is {image_size(path)} pixels, the frames {image_size(picture)}", "make the mask at their size")
    return path


LAYOUT = Layout(
    "open_illumination", "Lights/NNN/raw_undistorted/CAMERA.JPG, output/transforms_train.json, light_pos.npy", recognise, read
)
