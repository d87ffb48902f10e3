"""Frames as moving pictures: an animated WebP by Pillow, and H.264 in MP4 by the machine's own `ffmpeg`.

H.264 encoders come under the GPL (x264, also inside the wheels of PyAV and imageio-ffmpeg) or as builds tied to one vendor
(OpenH264): none is a library that this program may bring along. It runs the `ffmpeg` that it finds as a program instead.
"""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

WEBP_QUALITY = 85
ENCODERS: tuple[tuple[str, ...], ...] = (("libx264", "-crf", "18"), ("libopenh264", "-b:v", "8M"), ("h264",))
"""Tried in this order: not every build of ffmpeg has each."""
NO_FFMPEG = "no `ffmpeg` on the PATH that encodes H.264, so no .mp4 beside the .webp; `apt-get install ffmpeg` brings one"


def write_webp(path: Path, frames: Sequence[NDArray[np.uint8]], frames_per_second: float) -> None:
    """An endless animation of frames [H, W, 3]; those of another size than the first are scaled to it."""
    first, *rest = _of_one_size(frames)
    duration = round(1000 / frames_per_second)
    first.save(path, save_all=True, append_images=rest, duration=duration, loop=0, quality=WEBP_QUALITY)


def write_mp4(path: Path, frames: Sequence[NDArray[np.uint8]], frames_per_second: float) -> bool:
    """The same as H.264 that every player knows (4:2:0; an odd last row or column goes); False: no ffmpeg does it."""
    program = shutil.which("ffmpeg")
    if program is None:
        return False
    images = _of_one_size(frames)
    width, height = (n - n % 2 for n in images[0].size)
    pixels = b"".join(image.crop((0, 0, width, height)).tobytes() for image in images)
    given = ["-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{width}x{height}", "-r", f"{frames_per_second:g}", "-i", "-"]
    colours = ["-vf", "scale=out_color_matrix=bt709:out_range=tv", "-pix_fmt", "yuv420p", "-colorspace", "bt709"]
    colours += ["-color_primaries", "bt709", "-color_trc", "iec61966-2-1"]
    for encoder in ENCODERS:
        command = [program, "-loglevel", "error", "-y", *given, *colours, "-c:v", *encoder, str(path)]
        done = subprocess.run(command, input=pixels, capture_output=True, check=False)
        if done.returncode == 0 and path.is_file() and path.stat().st_size:
            return True
        path.unlink(missing_ok=True)
    return False


def _of_one_size(frames: Sequence[NDArray[np.uint8]]) -> list[Any]:
    from PIL import Image

    images = [Image.fromarray(frame) for frame in frames]
    return [image if image.size == images[0].size else image.resize(images[0].size) for image in images]
