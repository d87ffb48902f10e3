"""olat.json: where a light stage's frames lie, its lights and cameras, and the level at which frames are clipped."""

from __future__ import annotations

import json
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.capture import LightStage, LightStageCamera
from pipeline.capture.naming.files import RAW_SUFFIXES, some
from pipeline.engine.stage import StageRun
from pipeline.errors import UserError
from pipeline.formats.exr_frame import primaries_remark
from pipeline.formats.image_parts import without_alpha
from pipeline.formats.images import channel_names, picture_frame
from pipeline.geometry.cameras import frame_of
from pipeline.rig.frame_files import IN_DECODE
from stages.calib.decode.clip_level import PlateauSearch, top_of
from stages.calib.decode.frame_samples import frame_samples
from stages.calib.decode.linear_stage_frames import LinearFrames, radiometry_of, write_linear


def index_light_stage(stage: StageRun) -> None:
    """Write olat.json; every frame is looked at once, for its size, bad samples and the clip level, and written anew where it
    is not linear as it lies. Raises UserError."""
    light_stage = stage.capture.light_stage
    assert light_stage is not None
    for camera in light_stage.cameras.values():
        _refuse_other_channels(camera)
    radiometry = radiometry_of(stage, light_stage)
    frames = _looked_at(stage, light_stage) if radiometry is None else write_linear(stage, light_stage, radiometry)
    for first in (camera.cross[0] for camera in light_stage.cameras.values()):
        for fault in primaries_remark(picture_frame(first)) if first.suffix.lower() == ".exr" else ():
            stage.warn(f"{first}: {fault}")
    tops, bad = frames.tops, frames.bad
    if bad:
        worst = sorted(bad)[0]
        amount = f"{sum(bad.values())} samples in {len(bad)} frames"
        stage.warn(f"{worst}: {amount} are not finite; the fit leaves them out: check the export")
    black = [p for p, top in tops.items() if not top > 0]
    if len(black) == len(tops):
        raise UserError(stage.capture.root, "every light-stage frame is black", "check the export")
    if black:
        named = some(p.name for p in sorted(black))
        stage.warn(f"{sorted(black)[0]}: {len(black)} frames are black ({named}): check that their lights were on")
    stage.note("saturated_frames", frames.clipped_frames)
    table = _table(light_stage, stage.capture.root, frames)
    (stage.output / "olat.json").write_text(json.dumps(table, indent=1) + "\n")


def _refuse_other_channels(camera: LightStageCamera) -> None:
    """Raise UserError where one pass is grey and the other coloured: their brightnesses could not be compared."""
    cross, parallel = camera.cross[0], camera.parallel[0]
    if RAW_SUFFIXES & {cross.suffix.lower(), parallel.suffix.lower()}:
        return
    have, want = (len(without_alpha(channel_names(path, plain=True))) for path in (parallel, cross))
    if have != want:
        fault = f"has {have} colour channel{'s' * (have > 1)}, the crossed pass ({cross.name}) {want}"
        raise UserError(parallel, fault, "export both passes alike")


def _looked_at(stage: StageRun, light_stage: LightStage) -> LinearFrames:
    """What is to be known of frames that stay where they are."""
    frames = [(camera, path) for camera in light_stage.cameras.values() for path in camera.frames]
    search, tops, bad = PlateauSearch(), {}, {}

    def look(item: tuple[LightStageCamera, Path]) -> tuple[Path, tuple[float, int, int], int]:
        camera, path = item
        pixels, size = frame_samples(path)
        if size != (camera.camera.width, camera.camera.height):
            have, want = f"{size[0]}x{size[1]}", f"{camera.camera.width}x{camera.camera.height}"
            fault = f"is {have}, the camera's other frames {want}"
            raise UserError(path, fault, "export every frame of a camera in one size")
        finite = np.isfinite(pixels)
        wrong = int(pixels.size - np.count_nonzero(finite))
        return path, top_of(np.where(finite, pixels, 0) if wrong else pixels), wrong

    title = "looking at light-stage frames"
    with stage.progress.bar(title, len(frames), "frames") as bar, ThreadPoolExecutor(max(1, stage.jobs)) as pool:
        for path, top, wrong in pool.map(look, frames):
            search.tops.append(top)
            tops[path] = top[0]
            if wrong:
                bad[path] = wrong
            bar.advance()
    level = _stated_level(stage) or search.level()
    clipped = [path for path, top in tops.items() if level is not None and top >= level]
    return LinearFrames({}, level, _clipped_fraction(clipped, level, frames), len(clipped), tops, bad)


def _stated_level(stage: StageRun) -> float | None:
    """The clip level that capture.toml tells of samples scaled to 0..1; a white level that changes them is not met here."""
    radiometry = stage.capture.config.radiometry
    if radiometry.white_level is None and radiometry.saturation is None:
        return None
    return radiometry.saturation or 1.0


def _clipped_fraction(clipped: list[Path], level: float | None, frames: list[tuple[LightStageCamera, Path]]) -> float:
    """Share of all samples at or above the level."""
    if level is None or not frames:
        return 0.0
    pixels = {path: camera.camera.width * camera.camera.height for camera, path in frames}
    over = sum(float(np.mean(frame_samples(path)[0] >= np.float32(level))) * pixels[path] for path in clipped)
    return over / max(1, sum(pixels.values()))


def _table(light_stage: LightStage, root: Path, frames: LinearFrames) -> dict[str, Any]:
    def relative(path: Path | None) -> str | None:
        return None if path is None else frames.written.get(path, path.relative_to(root)).as_posix()

    lights = light_stage.lights
    cameras = {}
    for name, camera in sorted(light_stage.cameras.items()):
        c = camera.camera
        cameras[name] = {
            "cross": [relative(p) for p in camera.cross],
            "parallel": [relative(p) for p in camera.parallel],
            "passes": camera.passes,
            "mask": relative(camera.mask),
            "full_light": [relative(p) for p in camera.full_light],
            "width": c.width,
            "height": c.height,
            "camera": frame_of(c),
        }
    return {
        "schema": 1,
        **({"frames_in": IN_DECODE} if frames.written else {}),
        "cameras": cameras,
        "lights": {
            "directions": lights.directions.tolist(),
            "positions": lights.positions.tolist(),
            "intensity": lights.intensity.tolist(),
            **({"colour": lights.colour.tolist()} if lights.colour is not None else {}),
            "solid_angle": None if lights.solid_angle is None else lights.solid_angle.tolist(),
        },
        "saturated_fraction": frames.clipped_fraction,
        "saturation_level": frames.level,
    }
