"""Pinhole cameras: OpenCV axes, world-to-camera, pixel centres at +0.5; nerfstudio JSON in and out."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from pipeline.errors import UserError

OPENGL_FROM_OPENCV = np.diag([1.0, -1.0, -1.0, 1.0])  # flips y and z: OpenGL looks along -z with y up


@dataclass(frozen=True)
class Camera:
    """One view's pinhole camera.

    Lengths in world units, focal lengths and principal point in pixels. `name` is the physical camera (= polariser).
    `distortion` is OpenCV's (k1, k2, p1, p2), or empty.
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
        local = np.stack([(u - self.cx) / self.fx, (v - self.cy) / self.fy, np.ones_like(u)], -1)
        if any(self.distortion):
            local[..., :2] = undistort(local[..., :2], self.distortion)
        local /= np.linalg.norm(local, axis=-1, keepdims=True)
        return local @ self.world_to_camera[:3, :3]

    def stokes_frame(self) -> tuple[np.ndarray, np.ndarray]:
        """Each pixel's Stokes axes (x right, y up, both across its own ray), world, float64 [H, W, 3] each."""
        rays = self.rays()
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

    def resized(self, width: int, height: int) -> Camera:
        """The same camera for the image scaled to another size."""
        sx, sy = width / self.width, height / self.height
        return replace(self, width=width, height=height, fx=self.fx * sx, fy=self.fy * sy, cx=self.cx * sx, cy=self.cy * sy)


def distort(ideal: np.ndarray, distortion: tuple[float, ...]) -> np.ndarray:
    """Where a lens (OpenCV k1 k2 p1 p2) puts ideal normalised image points [..., 2]."""
    radial, tangential = _lens_terms(ideal, distortion)
    return ideal * radial[..., None] + tangential


def _lens_terms(ideal: np.ndarray, distortion: tuple[float, ...]) -> tuple[np.ndarray, np.ndarray]:
    k1, k2, p1, p2 = (*distortion, 0.0, 0.0, 0.0, 0.0)[:4]
    x, y = ideal[..., 0], ideal[..., 1]
    r2 = x * x + y * y
    tangential = np.stack([2 * p1 * x * y + p2 * (r2 + 2 * x * x), p1 * (r2 + 2 * y * y) + 2 * p2 * x * y], -1)
    return 1 + k1 * r2 + k2 * r2 * r2, tangential


def undistort(points: np.ndarray, distortion: tuple[float, ...], rounds: int = 20) -> np.ndarray:
    """Ideal normalised image points [..., 2] of distorted ones (OpenCV k1 k2 p1 p2), by fixed-point iteration."""
    ideal = points.copy()
    for _ in range(rounds):
        radial, tangential = _lens_terms(ideal, distortion)
        ideal = (points - tangential) / radial[..., None]
    return ideal


def camera_from_opengl(matrix: np.ndarray) -> np.ndarray:
    """World-to-camera (OpenCV) [4, 4] of an OpenGL camera-to-world matrix [4, 4] or [3, 4]."""
    full = np.eye(4)
    full[: len(matrix)] = matrix
    return np.linalg.inv(full @ OPENGL_FROM_OPENCV)


def opengl_from_camera(world_to_camera: np.ndarray) -> np.ndarray:
    """OpenGL camera-to-world [4, 4] of a world-to-camera (OpenCV) matrix [4, 4]."""
    return np.linalg.inv(world_to_camera) @ OPENGL_FROM_OPENCV


ROTATION_TOLERANCE = 0.01  # of R Rᵀ - 1: files that round to three digits pass, a scale of one percent does not
_INTRINSICS = ("fl_x", "fl_y", "cx", "cy", "w", "h", "k1", "k2", "p1", "p2")


def save_cameras(path: str | Path, cameras: Mapping[str, Camera]) -> None:
    """Write cameras by VIEW in nerfstudio's `transforms.json` schema, intrinsics per frame."""
    frames = []
    for view, c in sorted(cameras.items()):
        k1, k2, p1, p2 = (*c.distortion, 0.0, 0.0, 0.0, 0.0)[:4]
        numbers = dict(zip(_INTRINSICS, (c.fx, c.fy, c.cx, c.cy, c.width, c.height, k1, k2, p1, p2)))
        matrix = opengl_from_camera(c.world_to_camera).tolist()
        frames.append({"file_path": view, "camera": c.name, **numbers, "transform_matrix": matrix})
    Path(path).write_text(json.dumps({"camera_model": "OPENCV", "frames": frames}, indent=1) + "\n")


def camera_from_frame(frame: Mapping, shared: Mapping, path: Path) -> Camera:
    """The camera of one `transforms.json` frame; intrinsics from the frame, else from the file. Raises UserError."""
    get = {k: frame.get(k, shared.get(k)) for k in _INTRINSICS}
    if get["fl_x"] is None and "camera_angle_x" in {**shared, **frame} and get["w"]:
        get["fl_x"] = 0.5 * get["w"] / np.tan(0.5 * float({**shared, **frame}["camera_angle_x"]))
    get["fl_y"] = get["fl_x"] if get["fl_y"] is None else get["fl_y"]
    for centre, size in (("cx", "w"), ("cy", "h")):
        get[centre] = get[size] / 2 if get[centre] is None and get[size] is not None else get[centre]
    missing = [k for k in _INTRINSICS[:6] if get[k] is None]
    if missing or "transform_matrix" not in frame:
        wanted = ", ".join([*missing, *([] if "transform_matrix" in frame else ["transform_matrix"])])
        raise UserError(path, f"frame {frame.get('file_path', '?')} has no {wanted}", "add it to the file")
    matrix = np.asarray(frame["transform_matrix"], float)
    if matrix.shape not in ((4, 4), (3, 4)) or not np.isfinite(matrix).all():
        raise UserError(path, f"frame {frame.get('file_path', '?')}: transform_matrix is not a finite 4x4", "mend it")
    turn = matrix[:3, :3]
    if np.abs(turn @ turn.T - np.eye(3)).max() > ROTATION_TOLERANCE or np.linalg.det(turn) < 0:
        fault = f"frame {frame.get('file_path', '?')}: the 3x3 part of transform_matrix is not a rotation"
        raise UserError(path, fault, "take scale and mirroring out of it")
    if not (float(get["fl_x"]) > 0 and float(get["fl_y"]) > 0 and int(get["w"]) > 0 and int(get["h"]) > 0):
        raise UserError(path, f"frame {frame.get('file_path', '?')}: fl_x, fl_y, w and h must be above 0", "mend them")
    distortion = tuple(float(get[k] or 0.0) for k in ("k1", "k2", "p1", "p2"))
    return Camera(
        width=int(get["w"]),
        height=int(get["h"]),
        fx=float(get["fl_x"]),
        fy=float(get["fl_y"]),
        cx=float(get["cx"]),
        cy=float(get["cy"]),
        world_to_camera=camera_from_opengl(matrix),
        distortion=distortion if any(distortion) else (),
        name=str(frame.get("camera", "camera")),
    )


def load_cameras(path: str | Path) -> dict[str, Camera]:
    """Cameras by VIEW from a file that `save_cameras` wrote. Raises UserError."""
    path = Path(path)
    try:
        table = json.loads(path.read_text())
    except (OSError, ValueError) as error:
        raise UserError(path, f"cannot be read ({error})", "run the poses stage again") from error
    return {frame["file_path"]: camera_from_frame(frame, table, path) for frame in table["frames"]}
