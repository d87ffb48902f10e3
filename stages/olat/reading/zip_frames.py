"""Pixels of zip-compressed scan-line EXR frames, the usual kind, read directly: twice as many a second as through OpenImageIO.

Of OpenImageIO's time more than half goes into undoing zip's predictor byte by byte. Here libdeflate inflates the chunks of a
frame, and one kernel undoes the predictor and picks the mask's pixels. Whatever is not a whole file of this kind is left to
OpenImageIO: its words on what is wrong with a file are the ones a user reads.
"""

from __future__ import annotations

import os
import struct
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pipeline.formats.exr_zip import open_zip_exr
from pipeline.kernels import native
from stages.olat.reading.scanline_bands import Picked

SOURCE = Path(__file__).with_name("unpack_kernel.py")
ARGUMENTS = ("int64",) * 10 + ("pointer",) * 6
TOGETHER = 1 << 22  # bytes inflated before pixels are picked from them: what a reader holds of a large frame


@dataclass
class Header:
    """What frames written alike share: the header's bytes, its chunks, and where R, G, B are among its channels."""

    text: bytes
    width: int
    height: int
    channels: int
    sample_bytes: int
    chunk_rows: int
    rgb: tuple[int, int, int]

    @property
    def line(self) -> int:
        """Bytes of a row."""
        return self.width * self.channels * self.sample_bytes


def unpack_kernel() -> native.Kernel:
    """The kernel `unpack`, compiled where it was not."""

    def build() -> tuple[str, bytes]:
        from stages.olat.reading.unpack_kernel import build as compile_kernel  # loads numba

        return compile_kernel()

    return native.kernel("unpack", SOURCE, ARGUMENTS, build)


class ZipFrames:
    """A reader of one thread: it remembers the last frame's header, and holds the kernel's room."""

    def __init__(self) -> None:
        """Nothing is known of the frames yet."""
        self.header: Header | None = None
        self.words = np.empty(0, np.uint16)
        self.kernel = unpack_kernel()

    def read(self, path: Path, picked: Picked, half: bool, out: NDArray) -> bool:
        """Fill out [P, 3] (uint16 half bits or float32) with the pixels picked; False where the frame is OpenImageIO's."""
        import deflate

        try:
            with path.open("rb", buffering=0) as file:
                return self._read(file.fileno(), path, picked, half, out)
        except (OSError, ValueError, OverflowError, struct.error, deflate.DeflateError):
            return False  # damaged

    def _read(self, file: int, path: Path, picked: Picked, half: bool, out: NDArray) -> bool:
        known = self.header
        if known is None or os.pread(file, len(known.text), 0) != known.text:
            known = self.header = _header(path)
        if known is None or (known.width, known.height) != (picked.width, picked.height):
            return False
        if known.sample_bytes != (2 if half else 4):
            return False
        chunk = known.line * known.chunk_rows
        if len(self.words) < chunk // 2:
            self.words = np.empty(chunk // 2, np.uint16)
        step = max(1, TOGETHER // chunk) * known.chunk_rows
        last = min(-(-picked.bottom // known.chunk_rows) * known.chunk_rows, known.height)
        for top in range(picked.top - picked.top % known.chunk_rows, last, step):
            bottom = min(top + step, last)
            data, plain = _inflated(file, known, top, bottom)
            arrays = (
                np.frombuffer(data, np.uint8),
                np.frombuffer(plain, np.uint8),
                picked.starts,
                picked.columns,
                self.words,
                out,
            )
            self.kernel(
                picked.bottom - picked.top, known.width, known.channels, known.sample_bytes // 2, known.chunk_rows,
                picked.top - top, *known.rgb, bottom - top, *(array.ctypes.data for array in arrays),
            )  # fmt: skip
        return True


def _header(path: Path) -> Header | None:
    """The header of a frame; None where it is not a zip-compressed scan-line EXR with R, G, B or a single channel."""
    found = open_zip_exr(path)
    if found is None:
        return None
    with found.file as file:
        size = file.tell() - 8 * len(found.offsets)  # it has just been read, and the table of chunks after it
        file.seek(0)
        text = file.read(size)
    names = [name.lower() for name in found.names]
    if len(names) == 1:
        rgb = (0, 0, 0)
    elif {"r", "g", "b"} <= set(names) and len(set(names)) == len(names) and found.top == 0:
        rgb = (names.index("r"), names.index("g"), names.index("b"))
    else:
        return None
    return Header(text, *found.size, len(names), found.sample_bytes, found.chunk_rows, rgb)


def _inflated(file: int, header: Header, top: int, bottom: int) -> tuple[bytes, bytes]:
    """The bytes of rows [top, bottom), inflated, and for each chunk whether it had been left as it is. Raises ValueError."""
    import deflate

    first, count = top // header.chunk_rows, -(-(bottom - top) // header.chunk_rows)
    offsets = struct.unpack(f"<{count}Q", os.pread(file, 8 * count, len(header.text) + 8 * first))
    most = 8 + header.line * header.chunk_rows
    size = offsets[-1] + most - offsets[0]
    if not 0 < size <= 2 * count * most:
        raise ValueError("chunks do not lie one after another")
    stored = os.pread(file, size, offsets[0])
    parts, plain = [], bytearray()
    for row, offset in zip(range(top, bottom, header.chunk_rows), offsets):
        at, whole = offset - offsets[0], min(header.chunk_rows, bottom - row) * header.line
        said, size = struct.unpack_from("<ii", stored, at)
        packed = stored[at + 8 : at + 8 + size]
        if said != row or not 0 < size <= whole or len(packed) != size:
            raise ValueError("not a chunk")
        plain.append(size == whole)  # the writer keeps what zip would make larger
        parts.append(packed if size == whole else deflate.zlib_decompress(packed, whole))
        if len(parts[-1]) != whole:
            raise ValueError("a chunk is short")
    return b"".join(parts), bytes(plain)
