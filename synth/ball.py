"""A textured, polarised ellipsoid in closed form, small captures of which are written in a moment: for tests of the readers."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.geometry.cameras import Camera, camera_from_opengl, opengl_from_camera

SIZE, FOCAL, DISTANCE = 48, 93.0, 5.0
AXES = (0.9, 0.65, 0.75)
SUN = np.array([0.4, 0.8, 0.45]) / np.linalg.norm([0.4, 0.8, 0.45])
ORDER = (90, 45, 135, 0)


def ring(count: int, size: int = SIZE, rises: Sequence[float] = (-0.1, 0.35)) -> list[Camera]:
    """Cameras all around, at these elevations (radians) in turn, that look at the origin."""
    cameras = []
    for i in range(count):
        turn, rise = 2 * np.pi * i / count, rises[i % len(rises)]
        back = np.array([np.cos(turn) * np.cos(rise), np.sin(rise), np.sin(turn) * np.cos(rise)])
        right = np.cross([0, 1, 0], back)
        right /= np.linalg.norm(right)
        pose = np.eye(4)
        pose[:3] = np.stack([right, np.cross(back, right), back, DISTANCE * back], axis=1)
        focal = FOCAL * size / SIZE
        cameras.append(Camera(size, size, focal, focal, size / 2, size / 2, camera_from_opengl(pose)))
    return cameras


def picture(
    camera: Camera, light: NDArray[np.float64] = SUN, turn_deg: float = 0.0, ground: float = 0.06, texture: float = 1.0
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.bool_]]:
    """(colour [H, W, 3], Stokes [H, W, 3, 3], mask [H, W]) of the ellipsoid, turned about y, under a distant light."""
    c, s = np.cos(np.radians(turn_deg)), np.sin(np.radians(turn_deg))
    world_from_body = np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])
    axes = np.array(AXES)
    ray, origin = camera.rays() @ world_from_body / axes, camera.centre @ world_from_body / axes
    a, b, d = (ray * ray).sum(-1), ray @ origin, origin @ origin - 1
    root = b * b - a * d
    hit = root > 0
    on_unit = origin + ray * ((-b - np.sqrt(np.where(hit, root, 0))) / a)[..., None]
    normal = on_unit / axes
    normal = normal / np.linalg.norm(normal, axis=-1, keepdims=True) @ world_from_body.T
    x, y, z = np.moveaxis(on_unit * axes, -1, 0)
    pattern = 0.5 + texture * (0.25 * np.sin(9 * x) * np.sin(11 * y) + 0.2 * np.sin(13 * z + 2 * y))
    lit = 0.08 + 0.92 * np.clip(normal @ light, 0, 1)
    colour = np.stack([pattern, 0.8 * pattern, 0.5 * (1.2 - pattern)], -1) * lit[..., None]
    colour = np.where(hit[..., None], colour, ground)
    local = normal @ camera.world_to_camera[:3, :3].T
    angle = 2 * np.arctan2(-local[..., 1], local[..., 0])
    dolp = np.where(hit, 0.35 * np.clip(1 - local[..., 2] ** 2, 0, 1), 0.02)[..., None]
    s1, s2 = colour * dolp * np.cos(angle)[..., None], colour * dolp * np.sin(angle)[..., None]
    return colour.astype(np.float32), np.stack([colour, s1, s2], 2).astype(np.float32), hit


def behind(stokes: NDArray[np.float32], degrees: float) -> NDArray[np.float32]:
    """What a camera behind an ideal polariser at this angle sees, [H, W, 3]."""
    t = 2 * np.radians(degrees)
    return (stokes[:, :, 0] + stokes[:, :, 1] * np.cos(t) + stokes[:, :, 2] * np.sin(t)) / 2


def mosaic(stokes: NDArray[np.float32], order: Sequence[float] = ORDER) -> NDArray[np.float32]:
    """A monochrome 2x2 polariser mosaic [H, W]."""
    grey = stokes.mean(-1, keepdims=True)
    out = np.zeros(stokes.shape[:2], np.float32)
    for k, angle in enumerate(order):
        out[k // 2 :: 2, k % 2 :: 2] = behind(grey, angle)[k // 2 :: 2, k % 2 :: 2, 0]
    return out


def codes(linear: NDArray[Any], bits: int = 16) -> NDArray[Any]:
    """Linear values in 0..1 as integer codes."""
    top = 2**bits - 1
    return (np.clip(linear, 0, 1) * top + 0.5).astype(np.uint16 if bits == 16 else np.uint8)


def write(path: Path, pixels: NDArray[Any], kind: str | None = None) -> None:
    """An image file of any format that OpenImageIO writes, [H, W] or [H, W, C], as uint8, uint16 or half by its type."""
    import OpenImageIO as oiio

    path.parent.mkdir(parents=True, exist_ok=True)
    pixels = np.ascontiguousarray(pixels[..., None] if pixels.ndim == 2 else pixels)
    height, width, count = pixels.shape
    spec = oiio.ImageSpec(width, height, count, kind or {"uint8": "uint8", "uint16": "uint16"}.get(str(pixels.dtype), "half"))
    spec.channelnames = {1: ("Y",), 2: ("Y", "A"), 3: ("R", "G", "B"), 4: ("R", "G", "B", "A")}[count]
    spec.attribute("oiio:UnassociatedAlpha", 1)
    out = oiio.ImageOutput.create(str(path))
    if out is None or not out.open(str(path), spec) or not out.write_image(pixels) or not out.close():
        raise OSError(f"{path}: {oiio.geterror()}")


def transforms(cameras: Sequence[Camera], names: Sequence[str]) -> dict[str, Any]:
    """A transforms.json table of cameras that share their intrinsics."""
    c = cameras[0]
    frames = [
        {"file_path": name, "transform_matrix": opengl_from_camera(camera.world_to_camera).tolist()}
        for name, camera in zip(names, cameras)
    ]
    return {"fl_x": c.fx, "fl_y": c.fy, "cx": c.cx, "cy": c.cy, "w": c.width, "h": c.height, "frames": frames}


def save(path: Path, table: dict[str, Any]) -> None:
    """A table as JSON."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(table), encoding="utf-8")


# ---- a light stage -------------------------------------------------------------------------------------------------
def light_directions(count: int) -> NDArray[np.float64]:
    """Unit directions [N, 3] all over the sphere (Fibonacci's spiral)."""
    k = np.arange(count) + 0.5
    y, turn = 1 - 2 * k / count, np.pi * (1 + 5**0.5) * k
    r = np.sqrt(1 - y * y)
    return np.stack([r * np.cos(turn), y, r * np.sin(turn)], -1)


def stage_frame(light: NDArray[np.float64], specular: bool, size: int = 16) -> NDArray[np.float32]:
    """A ball seen from +z in one pass of a light stage, [H, W, 3]."""
    v, u = (np.mgrid[:size, :size] + 0.5 - size / 2) / (0.42 * size)
    normal = np.stack([u, -v, np.sqrt(np.clip(1 - u * u - v * v, 0, 1))], -1)
    shading = np.clip(normal @ light, 0, None)[..., None] * (u * u + v * v < 0.97)[..., None]
    half = light + np.array([0, 0, 1.0])
    half /= max(float(np.linalg.norm(half)), 1e-6)
    lobe = 0.1 * np.clip(normal @ half, 0, 1)[..., None] ** 30 * (shading > 0)
    return (shading * np.array([0.25, 0.18, 0.1]) + (lobe if specular else 0)).astype(np.float32)


def write_stage(
    root: Path,
    lights: int = 12,
    camera: str = "cam00",
    passes: tuple[str, str] = ("cross", "parallel"),
    first: int = 0,
    name: str = "{:06d}.exr",
    nest: str = "{camera}/{which}",
) -> NDArray[np.float64]:
    """A light stage of one camera without its light table; returns the directions [N, 3]. Frame k + first is light k."""
    size, distance = 16, 400.0
    directions = light_directions(lights)
    for which, specular in zip(passes, (False, True)):
        folder = root / nest.format(camera=camera, which=which)
        for k, light in enumerate(directions):
            write(folder / name.format(k + first), stage_frame(light, specular, size))
    focal = distance * 0.42 * size
    (root / "cameras").mkdir(exist_ok=True)
    (root / "cameras" / "camera00.txt").write_text(
        f"#focal length\n{focal} {focal}\n#principal point\n{size / 2} {size / 2}\n#resolution\n{size} {size}\n"
        f"#distortion coeffs\n0 0 0 0\nMATRIX :\n1 0 0 0\n0 1 0 0\n0 0 1 {distance}\n0 0 0 1\n"
    )
    return directions


def lights_csv(directions: NDArray[np.float64], index: Sequence[int] | None = None) -> str:
    """The text of a lights.csv."""
    rows = zip(range(len(directions)) if index is None else index, directions)
    return "index,x,y,z\n" + "".join(f"{i},{d[0]:.9f},{d[1]:.9f},{d[2]:.9f}\n" for i, d in rows)
