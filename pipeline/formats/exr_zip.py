"""Zip-compressed scan-line EXR, the usual kind, read directly.

Through OpenImageIO half the time goes into undoing the predictor byte by byte. Here libdeflate inflates a chunk, and its
bytes go to interleaved floats in one pass (`exr_kernels`): 1.7 times as many noisy Stokes pixels a second. Any other EXR
(tiles, parts, other compressions, subsampled or mixed channels, a data window that is not the display window, other
primaries, a damaged header) is OpenImageIO's: `open_zip_exr` says
None. Layout of the file: OpenEXR's "OpenEXR File Layout".
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from pipeline.formats.exr_frame import to_rec709

MAGIC = 20000630
VERSION, LONG_NAMES = 2, 0x400
CHUNK_ROWS = {2: 1, 3: 16}
"""Scan lines a chunk, by the header's code of the compression: ZIPS and ZIP."""
SAMPLE_BYTES = {1: 2, 2: 4}
"""Of the channel types half and float."""
LARGEST_HEADER = 1 << 20


@dataclass
class ZipExr:
    """An open file: `names` in file order, `size` (width, height); `sample_bytes` 2 (half) or 4 (float). Close `file`."""

    file: BinaryIO
    names: tuple[str, ...]
    size: tuple[int, int]
    sample_bytes: int
    chunk_rows: int
    top: int
    offsets: NDArray[np.uint64]

    def read(self, start: int, stop: int, place: NDArray[np.int64], out: NDArray[np.float32]) -> bool:
        """Rows start..stop (whole chunks) to out [rows, W, C], file channel c at out[..., place[c]]; False if corrupt."""
        import deflate

        from pipeline.formats.exr_kernels import place_floats, place_halves, undo_predictor

        width, height = self.size
        row = width * len(self.names)
        stored = np.empty(self.chunk_rows * row * (self.sample_bytes // 2), np.uint16)
        wide = np.empty(row, np.float32)
        for first in range(start, stop, self.chunk_rows):
            rows = min(self.chunk_rows, height - first)
            packed = self._chunk(first, rows * row * self.sample_bytes)
            if packed is None:
                return False
            words = stored[: rows * row * (self.sample_bytes // 2)]
            if len(packed) == words.nbytes:  # the writer keeps what zip would make larger
                words = np.frombuffer(packed, np.uint16)
            else:
                try:
                    inflated = deflate.zlib_decompress(packed, words.nbytes)
                except deflate.DeflateError:
                    return False
                if len(inflated) != words.nbytes:
                    return False
                undo_predictor(np.frombuffer(inflated, np.uint8), words)
            part = out[first - start : first - start + rows]
            if self.sample_bytes == 2:
                place_halves(words.reshape(rows, row), wide, wide.view(np.uint32), place, part)
            else:
                place_floats(words.view(np.float32).reshape(rows, row), place, part)
        return True

    def _chunk(self, first: int, most: int) -> bytes | None:
        """The stored bytes of the chunk that begins with row `first`, at most `most`; None where the file is damaged."""
        self.file.seek(int(self.offsets[first // self.chunk_rows]))
        head = self.file.read(8)
        if len(head) < 8:
            return None
        row, size = struct.unpack("<ii", head)
        if row != self.top + first or not 0 < size <= most:
            return None
        packed = self.file.read(size)
        return packed if len(packed) == size else None


def open_zip_exr(path: Path) -> ZipExr | None:
    """The file if it is a whole scan-line zip EXR with channels of one kind, else None: leave it to OpenImageIO."""
    file = path.open("rb")
    try:
        found = _opened(file)
    except (struct.error, ValueError, KeyError, IndexError, UnicodeDecodeError):
        found = None
    if found is None:
        file.close()
    return found


def _opened(file: BinaryIO) -> ZipExr | None:
    magic, version = struct.unpack("<II", file.read(8))
    if magic != MAGIC or version & 0xFF != VERSION or version & ~(0xFF | LONG_NAMES):
        return None
    attributes, end = _attributes(file.read(LARGEST_HEADER))
    rows = CHUNK_ROWS.get(attributes["compression"][0])
    left, top, right, bottom = struct.unpack("<4i", attributes["dataWindow"])
    channels = _channels(attributes["channels"])
    kinds = {kind for _, kind in channels}
    if rows is None or kinds not in ({1}, {2}):
        return None
    if attributes["displayWindow"] != attributes["dataWindow"]:
        return None
    primaries = attributes.get("chromaticities")
    if primaries is not None and to_rec709(struct.unpack("<8f", primaries)) is not None:
        return None
    width, height = right - left + 1, bottom - top + 1
    file.seek(8 + end)
    table = file.read(8 * -(-height // rows))
    offsets = np.frombuffer(table, "<u8")
    if len(offsets) != -(-height // rows) or not offsets.all():
        return None
    return ZipExr(file, tuple(name for name, _ in channels), (width, height), SAMPLE_BYTES[kinds.pop()], rows, top, offsets)


def _attributes(header: bytes) -> tuple[dict[str, bytes], int]:
    """Values by name, and where the header ends."""
    found: dict[str, bytes] = {}
    at = 0
    while header[at]:
        name, at = _text(header, at)
        _, at = _text(header, at)
        (size,) = struct.unpack_from("<i", header, at)
        found[name] = header[at + 4 : at + 4 + size]
        at += 4 + size
    return found, at + 1


def _channels(value: bytes) -> list[tuple[str, int]]:
    """(name, type) of each channel in the order of the samples. Raises ValueError on subsampled ones."""
    found, at = [], 0
    while value[at]:
        name, at = _text(value, at)
        kind, _, across, down = struct.unpack_from("<4i", value, at)
        if (across, down) != (1, 1):
            raise ValueError("subsampled")
        found.append((name, kind))
        at += 16
    return found


def _text(data: bytes, at: int) -> tuple[str, int]:
    end = data.index(b"\0", at)
    return data[at:end].decode(), end + 1
