"""Moving pictures of the mesh under every light: a turntable, and along a path of cameras that the user gives."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pipeline.engine.stage import StageRun
from pipeline.formats.dataset_files import CAMERAS, PATH, TURNTABLE
from pipeline.formats.images import srgb_encode, write_png, write_stokes
from pipeline.geometry.cameras import Camera, world_offset

from .camera_path import in_world, read_camera_path
from .lighting import Lighting
from .mesh_images import BakedMesh
from .orbit import orbit
from .video import NO_FFMPEG, write_mp4, write_webp

TURNTABLE_RATE = 1000 / 60  # frames a second: a turn of 48 takes three


def write_moving_pictures(
    run: StageRun,
    cameras: Mapping[str, Camera],
    lights: Mapping[str, Lighting],
    mesh: BakedMesh | None,
    path: Path | None,
) -> None:
    """What `turntable` and `cameras` ask for: ENV/turntable/NNN.png, ENV/path/NNN.exr and .png, and both as .webp and .mp4.

    cameras: of the capture's views; path: the file of cameras, where one is given.
    """
    p = run.parameters
    if not p.turntable and path is None:
        return
    if mesh is None:
        run.warn("there is no mesh, so no turntable and no camera path; check that the mesh stage ran")
        return
    if p.turntable:
        around = orbit(cameras, mesh.vertices, run.capture.up, p.turntable, p.turntable_size)
        _write(run, mesh, around, lights, TURNTABLE, TURNTABLE_RATE, stokes=False)
    if path is not None:
        along = in_world(read_camera_path(path), world_offset(run.inputs["poses"] / CAMERAS))
        _write(run, mesh, along.cameras, lights, PATH, along.frames_per_second, stokes=True)


def _write(
    run: StageRun,
    mesh: BakedMesh,
    cameras: Sequence[Camera],
    lights: Mapping[str, Lighting],
    name: str,
    rate: float,
    stokes: bool,
) -> None:
    """Frames are the outer loop: a frame's rays are cast once for all lights."""
    shown: dict[str, list[NDArray[np.uint8]]] = {light: [] for light in lights}
    with run.progress.bar(name, total=len(cameras) * len(lights), unit="frames") as bar:
        for k, camera in enumerate(cameras):
            seen = mesh.seen_by(camera)
            for light, lighting in lights.items():
                image = seen.image(lighting.of_mesh(seen))
                if stokes:
                    write_stokes(run.output / light / name / f"{k:03d}.exr", image)
                pixels = (srgb_encode(image[:, :, 0]) * 255 + 0.5).astype(np.uint8)
                write_png(run.output / light / name / f"{k:03d}.png", pixels)
                shown[light].append(pixels)
                bar.advance(1)
    done = True
    for light, frames in shown.items():
        write_webp(run.output / light / f"{name}.webp", frames, rate)
        done &= write_mp4(run.output / light / f"{name}.mp4", frames, rate)
    if not done:
        run.progress.say(f"{name}: {NO_FFMPEG}")
    run.note(name, {"frames": len(cameras), "mp4": done, **({} if done else {"reason": NO_FFMPEG})})
