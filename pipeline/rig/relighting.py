"""A light stage's object under an environment map: summed from its frames, or rendered from its fitted maps.

The sum of one-light-at-a-time frames (PRF section 5) is the reference: it holds every shadow and inter-reflection, at the
light stage's angular resolution. The maps' rendering is what a renderer gets from the fitted reflectance.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.formats.dataset_files import FITTED_LOBE
from pipeline.formats.images import RGB, XYZ, read_image
from pipeline.geometry.cameras import Camera
from pipeline.rig.frame_files import frames_root
from pipeline.rig.latlong_lights import as_lights, irradiance_per_light

READERS = 2
MAP_LIGHTS = 2000  # cells of 4.5 degrees; a lobe narrower than its cell is widened by it


def relight_frames(
    olat_index: Mapping[str, Any] | Path,
    capture_root: Path,
    camera: str,
    maps: Sequence[NDArray],
    mask: NDArray[np.bool_] | None = None,
    *,
    irradiance: float = np.pi,
    specular_factor: float = 2.0,
    up: str = "y",
    decode_folder: Path | None = None,
) -> NDArray[np.float32]:
    """Sum a light-stage camera's frames under maps; the frames are read once for all maps, one after another.

    Source: PRF Sec. 5.

    Args:
        olat_index: decode's olat.json, its path or content.
        capture_root: the capture's folder.
        camera: "camNN".
        maps: N latitude-longitude maps, linear, y up. [h, w, 3] each
        mask: black outside; None: everywhere. [H, W]
        irradiance: of a light in the frames (`capture.config.olat`).
        specular_factor: f of I_s = f (I_p - I_x) (`capture.config.olat`).
        up: the capture's up axis.
        decode_folder: where olat.json lies; needed with its content alone.

    Returns:
        The object's radiance under each map, >= 0. [N, H, W, 3]

    Raises:
        UserError: a frame cannot be read.
    """
    index = json.loads(Path(olat_index).read_text()) if isinstance(olat_index, str | Path) else olat_index
    entry = index["cameras"][camera]
    lights = index["lights"]
    directions, colour = np.array(lights["directions"]), np.array(lights.get("colour", [[1.0, 1.0, 1.0]]))
    weights = np.stack([irradiance_per_light(light, directions, up) for light in maps])  # [N, lights, 3]
    weights /= irradiance * np.array(lights["intensity"])[:, None] * colour
    decode = Path(olat_index).parent if isinstance(olat_index, str | Path) else Path(decode_folder or capture_root)
    root = frames_root(index, Path(capture_root), decode)
    out = np.zeros((len(maps), int(entry["height"]), int(entry["width"]), 3))

    def both(pair: tuple[str, str]) -> tuple[NDArray, NDArray]:
        return _frame(root / pair[0]), _frame(root / pair[1])

    pairs = list(zip(entry["cross"], entry["parallel"]))
    with ThreadPoolExecutor(READERS) as pool:
        for start in range(0, len(pairs), 2 * READERS):  # a bound on the frames in memory
            block = pairs[start : start + 2 * READERS]
            for k, (cross, parallel) in enumerate(pool.map(both, block), start):
                total = (2.0 - specular_factor) * cross + specular_factor * parallel  # I_d + I_s
                total *= 0.5 if entry.get("passes") == "none" else 1.0  # no polariser took half of it
                for image, weight in zip(out, weights[:, k]):
                    image += total * weight
    if mask is not None:
        out *= mask[..., None]
    return np.maximum(out, 0.0).astype(np.float32)


def _frame(path: Path) -> NDArray[np.float32]:
    pixels = read_image(path)
    pixels = read_image(path, RGB) if pixels.shape[2] >= 3 else np.repeat(pixels[..., :1], 3, -1)
    return np.nan_to_num(pixels, posinf=0.0, neginf=0.0)


def relight_maps(
    maps_folder: Path,
    camera: Camera,
    env_latlong: NDArray,
    *,
    up: str = "y",
    occlusion: bool = True,
    count: int = MAP_LIGHTS,
) -> NDArray[np.float32]:
    """Render a light-stage camera's fitted maps under an environment map.

    Args:
        maps_folder: the camera's in the olat stage's.
        camera: its pose and lens.
        env_latlong: linear, y up. [h, w, 3]
        up: the capture's up axis.
        occlusion: multiply diffuse and specular light by their occlusion maps (the frames' sum has their shadows).
        count: cells that the map's light is gathered into.

    Returns:
        Radiance, black outside the object. [H, W, 3]
    """
    directions, light, spacing = as_lights(env_latlong, count, up)
    return render_maps(maps_folder, camera, directions, light, spacing, occlusion)


def render_maps(
    maps_folder: Path,
    camera: Camera,
    directions: NDArray[np.float64],
    light: NDArray[np.float64],
    spacing: float = 0.0,
    occlusion: bool = True,
) -> NDArray[np.float32]:
    """The fitted maps under distant lights: directions [M, 3] (unit, world) of irradiance light [M, 3]; float32 [H, W, 3].

    spacing (rad): angle that each light stands for; lobes narrower than it are widened to it.
    """
    from pipeline.rig.lobe_names import LOBES
    from pipeline.rig.map_rendering import render_pixels

    folder = Path(maps_folder)
    facts = folder.parent / FITTED_LOBE
    lobe = LOBES[json.loads(facts.read_text())["lobe"]] if facts.is_file() else LOBES["ward"]

    def load(name: str, channels: tuple[str, ...]) -> NDArray[np.float32]:
        return read_image(folder / f"{name}.exr", channels)

    normal_d, normal_s, tangent = (load(name, XYZ) for name in ("diffuse_normal", "specular_normal", "tangent"))
    albedo_d, albedo_s = load("diffuse_albedo", RGB), load("specular_albedo", ("Y",))[..., 0]
    sigma = load("sigma", ("X", "Y"))
    inside = np.linalg.norm(normal_d, axis=-1) > 0.5
    view = -camera.rays()[inside]
    shade_d, shade_s = np.ones(len(view)), np.ones(len(view))
    if occlusion:
        shade_d, shade_s = (load(name, ("Y",))[..., 0][inside].astype(float) for name in ("occlusion_d", "occlusion_s"))
    rows = render_pixels(
        lobe, view, normal_d[inside].astype(float), normal_s[inside].astype(float), tangent[inside].astype(float),
        sigma[inside].astype(float), albedo_s[inside] * shade_s, np.ascontiguousarray(directions, float),
        np.ascontiguousarray(light, float), 0.5 * spacing,
    )  # fmt: skip
    out = np.zeros((*inside.shape, 3), np.float32)
    out[inside] = albedo_d[inside] * rows[:, 0] * shade_d[:, None] / np.pi + rows[:, 1]
    return out


def relighting_error(sum_of_frames: NDArray, from_maps: NDArray, mask: NDArray[np.bool_]) -> NDArray[np.float32]:
    """Compare a rendering from maps with the sum of the frames.

    Args:
        sum_of_frames: radiance. [H, W, 3]
        from_maps: radiance. [H, W, 3]
        mask: the object. [H, W]

    Returns:
        RMS over RGB, relative to the mean of the sum inside the mask (as it is where that is 0); 0 outside. [H, W]
    """
    level = float(np.mean(sum_of_frames[mask])) if mask.any() else 0.0
    error = np.sqrt(np.mean((np.asarray(from_maps, float) - sum_of_frames) ** 2, -1)) * mask
    return (error / level if level > 0 else error).astype(np.float32)
