"""A light stage's maps as painters and compositors take them: pictures in the camera's frame, with alpha."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import UserError
from pipeline.formats import dataset_files as files
from pipeline.formats.images import RGB, XYZ, read_image, srgb_encode, write_exr, write_png
from pipeline.formats.json_file import read_json
from pipeline.geometry.cameras import Camera, camera_from_frame

Image = NDArray[np.float32]
WIDEST = 1.0  # sigma of the brightest grey
NORMALS = ("normal", "diffuse_normal", "specular_normal")
GREYS = ("specular_albedo", "roughness", "anisotropy", "occlusion_d", "occlusion_s")


def export_maps(decode: Path, olat: Path, folder: Path) -> None:
    """Write each camera's maps to folder/CAMERA/NAME.png (16 bits, alpha: where there are maps), NAME_8.png, and maps.exr.

    Normals and tangents are in the camera's frame (x right, y up, z towards it), (n + 1) / 2. maps.exr holds all of them as
    layers NAME.R .., numbers as they are.

    Args:
        decode, olat: folders of these stages.
        folder: to write to.

    Raises:
        UserError: no camera has any maps.
    """
    table = read_json(decode / "olat.json", "run the decode stage again")["cameras"]
    names = [path.name for path in files.subfolders(olat) if path.name in table]
    if not names:
        raise UserError(olat, "holds no camera's maps", "run the olat stage again")
    for name in names:
        camera = camera_from_frame({"file_path": name, **table[name]["camera"]}, {}, decode / "olat.json")
        _write_camera(olat / name, camera, folder / name)
    about = {
        "normals and tangents": "(n + 1) / 2 in the camera's frame: x right, y up, z towards the camera (OpenGL)",
        "diffuse_albedo": "sRGB",
        "sigma": f"R larger, G smaller width, of {WIDEST:g}",
        "flag": "8 bits, the number itself (docs/light_stage.md)",
        "all other": "linear, 0 to 1",
        "alpha": "where there are maps; colours are not multiplied by it",
        "lobe": read_json(olat / files.FITTED_LOBE, "run the olat stage again").get("lobe"),
    }
    (folder / "maps.json").write_text(json.dumps(about, indent=1) + "\n")


def _write_camera(source: Path, camera: Camera, folder: Path) -> None:
    folder.mkdir(parents=True)
    there = np.linalg.norm(read_image(files.camera_map(source, "normal"), XYZ), axis=-1) > 0.5
    turn = camera.world_to_camera[:3, :3] * np.array([[1.0], [-1.0], [-1.0]])
    layers: dict[str, Image] = {}

    def add(name: str, values: Image, shown: Callable[[Image], NDArray] = lambda x: x) -> None:
        channels = RGB[: values.shape[-1]] if values.shape[-1] > 1 else ("Y",)
        layers.update({f"{name}.{c}": values[..., k] for k, c in enumerate(channels)})
        picture = np.concatenate([_rgb(shown(values)) * there[..., None], there[..., None]], -1).astype(np.float32)
        write_png(folder / f"{name}.png", picture, bits=16)
        write_png(folder / f"{name}_8.png", picture)

    for name in (*NORMALS, "tangent"):
        add(name, (read_image(files.camera_map(source, name), XYZ) @ turn.T).astype(np.float32), lambda n: n / 2 + 0.5)
    add("diffuse_albedo", read_image(files.camera_map(source, "diffuse_albedo"), RGB), srgb_encode)
    for name in GREYS:
        add(name, read_image(files.camera_map(source, name), ("Y",)))
    add("sigma", read_image(files.camera_map(source, "sigma"), ("X", "Y")), lambda s: s / WIDEST)
    flag = read_image(files.camera_map(source, "residual"), ("flag",))
    layers["flag.Y"] = flag[..., 0]
    write_png(folder / "flag.png", np.rint(flag[..., 0]).astype(np.uint8))
    write_exr(folder / "maps.exr", {**{c: layers[f"normal.{c}"] for c in RGB}, "A": there.astype(np.float32), **layers})


def _rgb(values: NDArray) -> NDArray:
    """Three channels: one is repeated, two get a third of 0."""
    if values.shape[-1] == 1:
        return np.repeat(values, 3, -1)
    return np.concatenate([values, np.zeros_like(values[..., :1])], -1) if values.shape[-1] == 2 else values
