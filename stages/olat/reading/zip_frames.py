"""Pixels of zip-compressed scan-line EXR frames, the usual kind, read directly: twice as many a second as through OpenImageIO.

Of OpenImageIO's time more than half goes into undoing zip's predictor byte by byte. Here libdeflate inflates the chunks of a
frame, and one kernel undoes the predictor and picks the mask's pixels. Whatever is not a whole file of this kind is left to
OpenImageIO: its words on what is wrong with a file are the ones a user reads.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pipeline.formats.exr_zip import ZipLayout, damage, open_zip_exr
from pipeline.kernels import native
from stages.olat.reading.scanline_bands import Picked

SOURCE = Path(__file__).with_name("unpack_kernel.py")
ARGUMENTS = ("int64",) * 10 + ("pointer",) * 6
TOGETHER = 1 << 22  # bytes inflated before pixels are picked from them: what a reader holds of a large frame


@dataclass(frozen=True)
class Frames:
    """What frames written alike share: their layout, and where R, G, B are among its channels."""

    layout: ZipLayout
    rgb: tuple[int, int, int]


def unpack_kernel() -> native.Kernel:
    """The kernel `unpack`, compiled where it was not."""

    def build() -> tuple[str, bytes]:
        from stages.olat.reading.unpack_kernel import build as compile_kernel  # loads numba

        return compile_kernel()

    return native.kernel("unpack", SOURCE, ARGUMENTS, build)


class ZipFrames:
    """A reader of one thread: it remembers the last frame's layout, and holds the kernel's room."""

    def __init__(self) -> None:
        """Nothing is known of the frames yet."""
        self.frames: Frames | None = None
        self.words = np.empty(0, np.uint16)
        self.kernel = unpack_kernel()

    def read(self, path: Path, picked: Picked, half: bool, out: NDArray) -> bool:
        """Fill out [P, 3] (uint16 half bits or float32) with the pixels picked; False where the frame is OpenImageIO's."""
        try:
            with path.open("rb", buffering=0) as file:
                return self._read(file.fileno(), path, picked, half, out)
        except damage():
            return False

    def _read(self, file: int, path: Path, picked: Picked, half: bool, out: NDArray) -> bool:
        known = self.frames
        if known is None or os.pread(file, len(known.layout.header), 0) != known.layout.header:
            known = self.frames = _frames_like(path)
        if known is None or known.layout.size != (picked.width, picked.height):
            return False
        layout = known.layout
        if layout.sample_bytes != (2 if half else 4):
            return False
        chunk, rows = layout.line * layout.chunk_rows, layout.chunk_rows
        if len(self.words) < chunk // 2:
            self.words = np.empty(chunk // 2, np.uint16)
        step = max(1, TOGETHER // chunk) * rows
        last = min(-(-picked.bottom // rows) * rows, picked.height)
        for top in range(picked.top - picked.top % rows, last, step):
            bottom = min(top + step, last)
            data, plain = zip(*layout.chunks(file, top, bottom))
            arrays = (
                np.frombuffer(b"".join(data), np.uint8),
                np.frombuffer(bytes(plain), np.uint8),
                picked.starts,
                picked.columns,
                self.words,
                out,
            )
            self.kernel(
                picked.bottom - picked.top, picked.width, len(layout.names), layout.sample_bytes // 2, rows,
                picked.top - top, *known.rgb, bottom - top, *(array.ctypes.data for array in arrays),
            )  # fmt: skip
        return True


def _frames_like(path: Path) -> Frames | None:
    """Frames written as this one; None where it is not a zip-compressed scan-line EXR with R, G, B or a single channel."""
    found = open_zip_exr(path)
    if found is None:
        return None
    found.file.close()
    names = [name.lower() for name in found.layout.names]
    if found.layout.top != 0:
        return None
    if len(names) == 1:
        return Frames(found.layout, (0, 0, 0))
    if {"r", "g", "b"} <= set(names) and len(set(names)) == len(names):
        return Frames(found.layout, (names.index("r"), names.index("g"), names.index("b")))
    return None
