"""Light stages: `camNN/cross` and `camNN/parallel` frames, LSX3 tables or a `lights.csv`, `cameras/cameraNN.txt`
or the cameras of other programs.

Covers the layout published with ICTPolarReal (`LSX3_*.txt`) and any other rig with a `lights.csv`.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np

from pipeline.capture.config import CaptureConfig
from pipeline.capture.layouts import Layout
from pipeline.capture.light_stage.folders import PASSES, CameraFolders, camera_file, stage_folders
from pipeline.capture.light_stage.frames import PassFrames, left_out_fact, one_pass_facts, pass_frames
from pipeline.capture.light_stage.given_cameras import GivenCameras, given_cameras
from pipeline.capture.light_stage.read_light_table import read_light_table, table_beside
from pipeline.capture.model import Capture, LightStage, LightStageCamera, Passes
from pipeline.capture.naming.files import find_environments, some
from pipeline.errors import UserError
from pipeline.geometry.camera_check import check_camera
from pipeline.geometry.cameras import OPENGL_FROM_OPENCV, Camera
from pipeline.geometry.straight_camera import unreached
from pipeline.rig.light_table import LightTable

FORMAT = (
    "add it (lines #focal length, #principal point, #resolution, #distortion coeffs, MATRIX :), a transforms.json or a COLMAP "
    "model, or remove the folder"
)


def recognise(root: Path) -> bool:
    """A folder `camNN/` that holds a `cross/` or a `parallel/`; other names of these need a light table or camera files.

    Beside transforms.json or a COLMAP model camera files alone do not do: two polarisers' views may lie in such folders.
    """
    cameras = stage_folders(root).values()
    if any(c.plain for c in cameras):
        return True
    views = any((root / name).exists() for name in ("transforms.json", "sparse"))
    files = any(camera_file(root, c.name).is_file() for c in cameras)
    return bool(cameras) and (table_beside(root) is not None or (files and not views))


def read(root: Path, config: CaptureConfig, beside: GivenCameras | None = None) -> Capture:
    """Open a light-stage capture. Raises UserError naming the file at fault. Pixels are not read.

    Args:
        root: its folder.
        config: its capture.toml.
        beside: the cameras of views in the same world, taken where the folder has none of its own.
    """
    from pipeline.rig.lsx3_and_csv_light_tables import LSX3_POSITIONS

    lights, tables = read_light_table(root, config)
    passes: dict[str, PassFrames] = {}
    folders = sorted(stage_folders(root).items())
    _refuse_mixed_passes(dict(folders))
    files_there = all(camera_file(root, name).is_file() for name, _ in folders)
    given = None if files_there else given_cameras(root) or beside
    pose = partial(_pose, root, config=config, given=given, alone=len(folders) == 1)
    cameras = {name: _camera(root, found, lights, tables[-1], config, passes, pose) for name, found in folders}
    files = [*tables, *(p for p in (camera_file(root, name) for name in cameras) if p.is_file())]
    files += given.files if given is not None else ()
    for camera in cameras.values():
        files += [*camera.frames, *([camera.mask] if camera.mask else [])]
    files += [root / "capture.toml"] if config.path is not None else []
    files += [root / name for name in (config.radiometry.dark_frame, config.radiometry.flat_field) if name]
    environments = find_environments(root)
    facts = [*left_out_fact(passes), *one_pass_facts(cameras)]
    if given is not None:
        where = "those of the views" if given is beside else given.path.relative_to(root).as_posix()
        facts.append(f"cameras: {where}")
    extra = {len(camera.full_light) for camera in cameras.values()} - {0}
    if extra:
        facts.append(f"{max(extra)} frames a pass beside the lights' own (all lights on, or dark) are left out")
    return Capture(
        root=root,
        layout="ict_light_stage" if tables[0].name == LSX3_POSITIONS else "light_stage",
        kind="light_stage",
        polarisation="polarisers",
        light_stage=LightStage(root, cameras, lights),
        environments=environments,
        config=config,
        up=config.up or "y",
        cameras={name: camera.camera for name, camera in cameras.items()},
        masks={name: camera.mask for name, camera in cameras.items() if camera.mask is not None} or None,
        files=tuple([*files, *environments]),
        facts=tuple(facts),
        warnings=tuple([*_masks_not_read(dict(folders), cameras), *(_looking_away(cameras, root) if given is None else [])]),
    )


def _masks_not_read(folders: dict[str, CameraFolders], cameras: dict[str, LightStageCamera]) -> list[str]:
    """A line for a mask of a kind that is not read, where a camera has no other."""
    bare = [folders[name].home for name, camera in cameras.items() if camera.mask is None]
    found = [p for home in bare for p in sorted(home.iterdir()) if p.stem.lower() == "mask" and p.is_file()]
    return [f"{found[0]}: is no mask that is read, and a matte is made: write mask.png, white on the object"] if found else []


def _looking_away(cameras: dict[str, LightStageCamera], root: Path) -> list[str]:
    """A line where most cameras have the stage's centre, which is the origin of their files, behind them."""
    behind = [name for name, c in cameras.items() if float(c.camera.project(np.zeros(3))[1]) < 0]
    if len(behind) <= len(cameras) / 2:
        return []
    fault = f"the stage's centre (0, 0, 0) lies behind {some(behind)}"
    return [f"{camera_file(root, behind[0])}: {fault}: check that its matrix is camera to world, with OpenGL's axes"]


def _refuse_mixed_passes(folders: dict[str, CameraFolders]) -> None:
    """Raise UserError where a camera lacks a pass that another has: left out by accident, it would be fitted otherwise."""
    every = {which for found in folders.values() for which in found.passes}
    for found in folders.values():
        for which in PASSES:
            if which in every and which not in found.passes:
                fault = "is missing: other cameras have that pass"
                raise UserError(found.home / which, fault, "add the frames, or remove the camera's folder")


def _camera(
    root: Path, folders: CameraFolders, lights: LightTable, table: Path, config: CaptureConfig, found: dict[str, PassFrames],
    pose: Callable[[CameraFolders, tuple[int, int]], Camera],
) -> LightStageCamera:  # fmt: skip
    from pipeline.capture.assembly.sources import size_of
    from pipeline.formats.images import image_size

    passes = {}
    for name in folders.passes:
        passes[name] = pass_frames(folders.passes[name], lights, table, config.olat.first_frame)
        found[f"{folders.name}/{name}"] = passes[name]
    cross, parallel = (passes.get(name, next(iter(passes.values()))) for name in PASSES)
    kind: Passes = "both" if len(passes) == len(PASSES) else "cross" if "cross" in passes else "parallel"
    sizes = {name: size_of(p.frames[0]) for name, p in passes.items()}
    size = sizes.get("cross", next(iter(sizes.values())))
    if len(set(sizes.values())) > 1:
        fault = f"is {sizes['parallel']} pixels, the cross pass {sizes['cross']}"
        raise UserError(passes["parallel"].frames[0], fault, "export both passes at one size")
    mask = _mask(root, folders)
    if mask is not None and image_size(mask) != size:
        raise UserError(mask, f"is {image_size(mask)} pixels, the frames {size}", "make the mask at the frames' size")
    return LightStageCamera(folders.name, cross.frames, parallel.frames, mask, pose(folders, size), cross.full_light, kind)


def _pose(
    root: Path, folders: CameraFolders, size: tuple[int, int], config: CaptureConfig, given: GivenCameras | None, alone: bool
) -> Camera:
    """A camera for frames of (width, height): its file's, else the one given beside. Raises UserError without."""
    path = camera_file(root, folders.name)
    if path.is_file():
        return read_camera(path, *size, name=folders.name, distortion=config.olat.distortion)
    if given is not None:
        return given.of(folders.name, size, alone)
    for place in folders.home.parents[: len(folders.home.relative_to(root).parts) - 1]:
        if camera_file(place, folders.name).is_file():
            raise UserError(root, f"is not the light stage itself: that is {place.name}", f"give CAPTURE={place}")
    raise UserError(path, f"{folders.home.name} has images but no camera file", FORMAT)


def _mask(root: Path, folders: CameraFolders) -> Path | None:
    """mask.png (or .exr, .jpg) beside the passes, or masks/CAMERA.png."""
    names = ("mask.png", "mask.exr", "mask.jpg")
    beside = [p for p in sorted(folders.home.iterdir()) if p.is_file() and p.name.lower() in names]
    named = [root / "masks" / f"{name}.png" for name in (folders.name, folders.home.name)]
    return next((p for p in (*beside, *named) if p.is_file()), None)


def read_camera(path: Path, width: int, height: int, name: str = "camera", distortion: bool = False) -> Camera:
    """Read an LSX3 camera file: camera-to-world with OpenGL axes, intrinsics of the full frame.

    Args:
        path: the file.
        width, height: of the images, pixels: the full frame scaled by height, square pixels, centred.
        name: the camera's.
        distortion: apply the file's k1 k2 p1 p2.

    Returns:
        The camera for images of that size.

    Raises:
        UserError: a block is missing or malformed, or the result can be no camera.
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
