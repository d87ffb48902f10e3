"""Pinhole cameras: OpenCV axes, world-to-camera, pixel centres at +0.5; nerfstudio JSON in and out."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.errors import UserError
from pipeline.formats.json_file import read_json
from pipeline.geometry.camera_check import check_camera
from pipeline.geometry.lens_inverse import unproject
from pipeline.geometry.lens_keys import lens_of, number
from pipeline.geometry.lens_models import MODELS, PINHOLE, is_pinhole, project

OPENGL_FROM_OPENCV = np.diag([1.0, -1.0, -1.0, 1.0])  # flips y and z: OpenGL looks along -z with y up

RAY_ROWS = 32  # of a frame that are solved together: a large frame's rays are large


@dataclass(frozen=True)
class Camera:
    """One view's camera: a pinhole, or one with a lens that bends lines until the poses stage has straightened its frames.

    Axes are OpenCV's (x right, y down, z ahead), pixel centres lie at +0.5.

    Fields:
        width, height: pixels.
        fx, fy: focal lengths, pixels.
        cx, cy: principal point, pixels.
        world_to_camera: rigid, lengths in world units. [4, 4]
        distortion: coefficients of `lens`; none: a pinhole.
        name: of the physical camera, which stands for its polariser.
        lens: a model of `lens_models`.
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    world_to_camera: np.ndarray = field(repr=False)
    distortion: tuple[float, ...] = ()
    name: str = "camera"
    lens: str = PINHOLE

    @property
    def is_pinhole(self) -> bool:
        """Whether it keeps straight lines straight."""
        return is_pinhole(self.lens, self.distortion)

    @property
    def intrinsics(self) -> np.ndarray:
        """Pinhole matrix, float64 [3, 3]."""
        return np.array([[self.fx, 0, self.cx], [0, self.fy, self.cy], [0, 0, 1.0]])

    @property
    def camera_to_world(self) -> np.ndarray:
        """Inverse of `world_to_camera` for a rigid motion, float64 [4, 4]."""
        rotation, translation = self.world_to_camera[:3, :3], self.world_to_camera[:3, 3]
        out = np.eye(4)
        out[:3, :3], out[:3, 3] = rotation.T, -rotation.T @ translation
        return out

    @property
    def centre(self) -> np.ndarray:
        """Camera centre in the world, float64 [3]."""
        return self.camera_to_world[:3, 3]

    @property
    def up(self) -> np.ndarray:
        """World direction of the image's upward axis, float64 [3]."""
        return -self.world_to_camera[1, :3]

    def rays(self) -> np.ndarray:
        """Unit viewing directions away from the camera, world, float64 [H, W, 3]."""
        u, v = np.meshgrid(np.arange(self.width) + 0.5, np.arange(self.height) + 0.5)
        local = self._in_plane(u, v)
        if not self.is_pinhole:
            for start in range(0, self.height, RAY_ROWS):
                rows = local[start : start + RAY_ROWS]
                rows[:] = unproject(self.lens, self.distortion, rows[..., :2])
        local /= np.linalg.norm(local, axis=-1, keepdims=True)
        return local @ self.world_to_camera[:3, :3]

    def rays_through(self, pixels: np.ndarray) -> np.ndarray:
        """Directions through chosen pixels: those of a whole large frame are gigabytes.

        Args:
            pixels: row * width + column of each. [P]

        Returns:
            What `rays` has there, float64. [P, 3]
        """
        v, u = np.divmod(pixels, self.width)
        if self.is_pinhole:
            local = self._in_plane(u + 0.5, v + 0.5)
            local /= np.linalg.norm(local, axis=-1, keepdims=True)
        else:
            local = self.rays_at(np.stack([u + 0.5, v + 0.5], -1))
        return local @ self.world_to_camera[:3, :3]

    def _in_plane(self, u: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Where pixel positions lie in the plane at distance 1 of a camera without distortion: [..., 3]."""
        return np.stack([(u - self.cx) / self.fx, (v - self.cy) / self.fy, np.ones_like(u)], -1)

    def stokes_frame(self) -> tuple[np.ndarray, np.ndarray]:
        """Each pixel's Stokes axes (x right, y up, both across its own ray), world, float64 [H, W, 3] each."""
        return self.stokes_axes(self.rays())

    def stokes_axes(self, rays: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The Stokes axes of unit rays [..., 3] (world), float64 [..., 3] each."""
        x = np.cross(rays, self.up)
        x /= np.linalg.norm(x, axis=-1, keepdims=True)
        return x, np.cross(x, rays)

    def project(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Pixel positions [..., 2] and camera-frame depths [...] of world points [..., 3], without distortion."""
        local = points @ self.world_to_camera[:3, :3].T + self.world_to_camera[:3, 3]
        z = local[..., 2]
        with np.errstate(divide="ignore", invalid="ignore"):
            pixels = np.stack([self.fx * local[..., 0] / z + self.cx, self.fy * local[..., 1] / z + self.cy], -1)
        return pixels, z

    def pixels_of(self, rays: np.ndarray) -> np.ndarray:
        """Pixel positions [..., 2] of rays [..., 3] of the camera's frame, through its lens; NaN where there are none."""
        return project(self.lens, self.distortion, rays) * [self.fx, self.fy] + [self.cx, self.cy]

    def rays_at(self, pixels: np.ndarray) -> np.ndarray:
        """Unit rays [..., 3] of the camera's frame at pixel positions [..., 2], through its lens; NaN where there are none."""
        return unproject(self.lens, self.distortion, (pixels - [self.cx, self.cy]) / [self.fx, self.fy])

    def resized(self, width: int, height: int) -> Camera:
        """The same camera for the image scaled to another size."""
        sx, sy = width / self.width, height / self.height
        return replace(self, width=width, height=height, fx=self.fx * sx, fy=self.fy * sy, cx=self.cx * sx, cy=self.cy * sy)


def camera_from_opengl(matrix: np.ndarray) -> np.ndarray:
    """Convert an OpenGL camera-to-world matrix (x right, y up, looking along -z) to an OpenCV world-to-camera one.

    Args:
        matrix: rigid. [4, 4] or [3, 4]

    Returns:
        World-to-camera. [4, 4]
    """
    full = np.eye(4)
    full[: len(matrix)] = matrix
    return np.linalg.inv(full @ OPENGL_FROM_OPENCV)


def opengl_from_camera(world_to_camera: np.ndarray) -> np.ndarray:
    """Convert an OpenCV world-to-camera matrix to an OpenGL camera-to-world one.

    Args:
        world_to_camera: rigid. [4, 4]

    Returns:
        Camera-to-world. [4, 4]
    """
    return np.linalg.inv(world_to_camera) @ OPENGL_FROM_OPENCV


_INTRINSICS = ("fl_x", "fl_y", "cx", "cy", "w", "h")
_ANGLES = ("camera_angle_x", "camera_angle_y")


def frame_of(camera: Camera) -> dict[str, Any]:
    """Write a camera as the keys of a nerfstudio frame; `camera_from_frame` reads it back.

    Args:
        camera: any.

    Returns:
        Size, intrinsics (pixels), lens model and coefficients, OpenGL camera-to-world `transform_matrix`.
    """
    model = {} if camera.lens == PINHOLE else {"camera_model": camera.lens}
    names = MODELS[camera.lens].names
    coefficients = dict(zip(names, (*camera.distortion, *(0.0,) * len(names))))
    numbers = dict(zip(_INTRINSICS, (camera.fx, camera.fy, camera.cx, camera.cy, camera.width, camera.height)))
    return {**numbers, **model, **coefficients, "transform_matrix": opengl_from_camera(camera.world_to_camera).tolist()}


def save_cameras(
    path: str | Path,
    cameras: Mapping[str, Camera],
    files: Mapping[str, str] | None = None,
    offset: np.ndarray | None = None,
) -> None:
    """Write cameras in nerfstudio's `transforms.json` schema, intrinsics per frame.

    Args:
        path: the file; its folder exists.
        cameras: by VIEW; written in the views' sorted order.
        files: VIEW to its image, relative to the file's folder; None: VIEW itself.
        offset: what was taken from all positions, world units: true position = position in the file + offset; None: zero. [3]
    """
    frames = [
        {"file_path": (files or {}).get(view, view), "view": view, "camera": camera.name, **frame_of(camera)}
        for view, camera in sorted(cameras.items())
    ]
    offset_entry = {} if offset is None or not np.any(offset) else {"world_offset": [float(x) for x in offset]}
    Path(path).write_text(json.dumps({"camera_model": PINHOLE, **offset_entry, "frames": frames}, indent=1) + "\n")


def camera_from_frame(frame: Mapping[str, Any], shared: Mapping[str, Any], path: Path) -> Camera:
    """Read the camera of one frame of a `transforms.json` (nerfstudio's schema).

    Args:
        frame: the frame's keys; its intrinsics go before the file's.
        shared: the file's own keys.
        path: the file, for errors.

    Returns:
        The camera; its name is the frame's `camera`.

    Raises:
        UserError: a key is missing or no number, or the result can be no camera.
    """
    what = f"frame {frame.get('file_path', '?')}"
    entry = {**shared, **frame}
    lens, distortion = lens_of(frame, shared, path, what)
    get = {k: number(entry[k], k, path, what) for k in (*_INTRINSICS, *_ANGLES) if entry.get(k) is not None}
    _complete(get, lens)
    missing = [k for k in _INTRINSICS if k not in get]
    if missing or "transform_matrix" not in frame:
        wanted = ", ".join([*missing, *([] if "transform_matrix" in frame else ["transform_matrix"])])
        raise UserError(path, f"{what} has no {wanted}", "add it to the file")
    size = {"w": get["w"], "h": get["h"]}
    for key, value in size.items():
        if value != int(value):
            raise UserError(path, f"{what}: {key} = {value:g} is not a whole number of pixels", "give the image's size")
    matrix = _matrix(frame["transform_matrix"], path, what)
    try:
        pose = camera_from_opengl(matrix)
    except np.linalg.LinAlgError:
        pose = np.zeros((4, 4))  # refused below
    camera = Camera(
        width=int(get["w"]),
        height=int(get["h"]),
        fx=get["fl_x"],
        fy=get["fl_y"],
        cx=get["cx"],
        cy=get["cy"],
        world_to_camera=pose,
        distortion=distortion,
        name=str(frame.get("camera", "camera")),
        lens=lens,
    )
    return check_camera(camera, path, what)


def _complete(get: dict[str, float], lens: str) -> None:
    """Fill in what others of the intrinsics tell, in place."""
    if lens == "EQUIRECTANGULAR" and {"w", "h"} <= set(get):  # the whole sphere: its size says everything
        get |= {"fl_x": get["w"] / (2 * np.pi), "fl_y": get["h"] / np.pi, "cx": get["w"] / 2, "cy": get["h"] / 2}
    for focal, angle, size in (("fl_x", "camera_angle_x", "w"), ("fl_y", "camera_angle_y", "h")):
        if focal not in get and angle in get and size in get and 0 < get[angle] < np.pi:
            get[focal] = 0.5 * get[size] / np.tan(0.5 * get[angle])
    for focal, other in (("fl_x", "fl_y"), ("fl_y", "fl_x")):
        if focal not in get and other in get:
            get[focal] = get[other]
    for centre, size in (("cx", "w"), ("cy", "h")):
        if centre not in get and size in get:
            get[centre] = get[size] / 2


def _matrix(value: Any, path: Path, what: str) -> np.ndarray:
    """A finite [4, 4] or [3, 4]. Raises UserError."""
    try:
        matrix = np.asarray(value, float)
    except (TypeError, ValueError, OverflowError):
        matrix = np.zeros(0)
    if matrix.shape not in ((4, 4), (3, 4)) or not np.isfinite(matrix).all():
        raise UserError(path, f"{what}: transform_matrix is not a finite 4x4", "mend it")
    return matrix


def load_cameras(path: str | Path) -> dict[str, Camera]:
    """Read the cameras that `save_cameras` wrote.

    Args:
        path: the file.

    Returns:
        Cameras by VIEW, in file order; positions less the file's `world_offset`.

    Raises:
        UserError: the file is missing or damaged, or holds what can be no camera.
    """
    path = Path(path)
    table = _written(path)
    return {frame["view"]: camera_from_frame(frame, table, path) for frame in table["frames"]}


def world_offset(path: str | Path) -> np.ndarray:
    """Read what `save_cameras` says was taken from all positions.

    Args:
        path: the file.

    Returns:
        The offset, world units, zero where the file has none. [3]

    Raises:
        UserError: the file is missing or damaged.
    """
    return np.array(_written(Path(path)).get("world_offset", (0.0, 0.0, 0.0)), float)


def _written(path: Path) -> dict[str, Any]:
    remedy = "run the poses stage again"
    table = read_json(path, remedy)
    frames = table.get("frames") if isinstance(table, dict) else None
    if not isinstance(frames, list) or not all(isinstance(f, dict) and isinstance(f.get("view"), str) for f in frames):
        raise UserError(path, "holds no frames with their views", remedy)
    return table
