"""`python -m stages.calib.decode.ball_lights FRAMES [--mask BALL.png] -o lights.csv`: a light table from a ball in view."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np

from pipeline.capture.config import CaptureConfig
from pipeline.capture.light_stage.frame_numbers import frame_files, numbered
from pipeline.capture.pixels.linear import read_linear
from pipeline.errors import UserError
from pipeline.formats.given_mask import read_given
from pipeline.geometry.cameras import OPENGL_FROM_OPENCV, Camera
from pipeline.rig.ball_calibration import BallLights, calibrated
from pipeline.rig.ball_outline import Outline, find_ball

DOUBTFUL = 1.0  # degrees of a direction's own standard deviation that are worth a line


def table_of(
    folder: Path, mask_path: Path | None, kind: str, camera_path: Path | None, found_in: Path | None = None
) -> tuple[list[int], BallLights, np.ndarray, Outline | None]:
    """Numbers of the frames in `folder`, their lights by the ball, the directions in the world [N, 3], and the ball's outline
    where it was found by itself: without a mask, in the picture `found_in`, or in the frames' mean.

    Raises UserError where there is no ball or a doubtful one, or no frame shows a light.
    """
    frames = dict(sorted(numbered(frame_files(folder)).items()))
    if not frames:
        raise UserError(folder, "holds no numbered frames", "name the folder of the frames, one light each")
    images = [_linear(path) for path in frames.values()]
    shape = images[0].shape[:2]
    for path, image in zip(frames.values(), images):
        if image.shape[:2] != shape:
            raise UserError(
                path, f"is {image.shape[1]}x{image.shape[0]}, others {shape[1]}x{shape[0]}", "give frames of one size"
            )
    outline = None
    if mask_path is not None:
        mask = read_given(mask_path).pixels.astype(np.float64) / 255
        if mask.shape != shape:
            raise UserError(
                mask_path, f"is {mask.shape[1]}x{mask.shape[0]}, the frames {shape[1]}x{shape[0]}", "make it their size"
            )
        if not (mask > 0.5).any():
            raise UserError(mask_path, "shows no ball", "paint the ball white, everything else black")
    else:
        outline = _outline(folder, images, found_in, shape)
        mask = outline.mask(shape)
    camera = _camera(camera_path, mask.shape) if camera_path is not None else None
    optics = (camera.fx, (camera.cx, camera.cy)) if camera is not None else (None, None)
    found = calibrated(images, mask, kind, *optics)
    if not found.seen.any():
        raise UserError(folder, f"no frame shows a light on the {kind} ball", "check the mask, and --kind")
    turn = np.eye(3) if camera is None else (OPENGL_FROM_OPENCV[:3, :3] @ camera.world_to_camera[:3, :3])
    return list(frames), found, found.directions @ turn, outline


def _linear(path: Path) -> np.ndarray:
    return np.asarray(read_linear(path, CaptureConfig().radiometry).rgb(path), np.float64)


def _outline(folder: Path, images: list[np.ndarray], found_in: Path | None, shape: tuple[int, ...]) -> Outline:
    picture = _linear(found_in) if found_in is not None else np.mean(images, axis=0)
    where = found_in or folder
    if picture.shape[:2] != shape:
        raise UserError(
            where, f"is {picture.shape[1]}x{picture.shape[0]}, the frames {shape[1]}x{shape[0]}", "make it their size"
        )
    try:
        return find_ball(picture)
    except ValueError as fault:
        remedy = "give --mask, a picture that is white on the ball"
        raise UserError(where, f"no ball is found by itself: {fault}", remedy) from None


def _camera(path: Path, shape: tuple[int, ...]) -> Camera:
    from pipeline.capture.layouts.ict_light_stage import read_camera

    return read_camera(path, shape[1], shape[0])


def write_table(path: Path, numbers: list[int], found: BallLights, directions: np.ndarray) -> None:
    """lights.csv of the lights that were seen: index, direction, intensity and colour."""
    rows = ["index,x,y,z,red,green,blue"]
    for number, seen, direction, colour in zip(numbers, found.seen, directions, found.colours):
        if seen:
            rows.append(",".join([str(number), *(f"{v:.6f}" for v in (*direction, *colour))]))
    path.write_text("\n".join(rows) + "\n")


def main(arguments: list[str] | None = None) -> int:
    """Calibrate, write the table, say the residual; 2 on a user's mistake."""
    parser = argparse.ArgumentParser(prog="python -m stages.calib.decode.ball_lights", description=__doc__)
    parser.add_argument("frames", type=Path, help="folder of the frames, one light each")
    parser.add_argument("--mask", type=Path, help="picture that is white on the ball; without one it is looked for")
    parser.add_argument("--find-in", type=Path, help="picture to look for the ball in, all lights on (the frames' mean)")
    parser.add_argument("--kind", choices=("mirror", "matte"), default="mirror", help="mirror ball, or a grey or white one")
    parser.add_argument("--camera", type=Path, help="camera file (cameraNN.txt): perspective, and directions in its world")
    parser.add_argument("-o", "--output", type=Path, default=Path("lights.csv"), help="table to write")
    a = parser.parse_args(arguments)
    try:
        numbers, found, directions, outline = table_of(a.frames, a.mask, a.kind, a.camera, a.find_in)
        write_table(a.output, numbers, found, directions)
    except UserError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    if outline is not None:
        place = f"centre ({outline.x:.1f}, {outline.y:.1f}), radius {outline.radius:.1f} px"
        print(f"ball: {place}; its edge is off that by {outline.residual:.2f} px and seen over {100 * outline.covered:.0f} %")
    deviation = found.residual_deg[found.seen]
    residual = f"residual {np.median(deviation):.2f} degrees (median), {deviation.max():.2f} at most"
    print(f"{a.output}: {int(found.seen.sum())} of {len(numbers)} lights, {residual}")
    for number in [n for n, seen in zip(numbers, found.seen) if not seen]:
        print(f"warning: frame {number} shows no light on the ball: left out; check that its light was on", file=sys.stderr)
    if np.median(deviation) > DOUBTFUL:
        print("warning: directions are uncertain: check the mask's outline, and --kind", file=sys.stderr)
    return 0


if __name__ == "__main__":
    sys.exit(main())
