"""Zip-compressed scan-line EXR, the usual kind, read directly.

Through OpenImageIO half the time goes into undoing the predictor byte by byte. Here libdeflate inflates a chunk, and its
bytes go to interleaved floats in one pass (`exr_kernels`): 1.7 times as many noisy Stokes pixels a second. Any other EXR
(tiles, parts, other compressions, subsampled or mixed channels, a data window that is not the display window, other
primaries, a damaged header) is OpenImageIO's: `open_zip_exr` says
None. Layout of the file: OpenEXR's "OpenEXR File Layout".
"""

from __future__ import annotations

import os
import struct
from collections.abc import Iterator, Mapping
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
REQUIRED = {
    "channels": ("chlist", None), "compression": ("compression", 1), "lineOrder": ("lineOrder", 1),
    "dataWindow": ("box2i", 16), "displayWindow": ("box2i", 16), "pixelAspectRatio": ("float", 4),
    "screenWindowCenter": ("v2f", 8), "screenWindowWidth": ("float", 4),
}  # fmt: skip
"""Attributes that every header holds, with their types and bytes."""


@dataclass(frozen=True)
class ZipLayout:
    """What files that are written alike share: enough to find and inflate any row.

    Fields:
        header: the file's bytes up to the table of chunks.
        names: channels in file order.
        size: width, height in pixels.
        sample_bytes: 2 (half) or 4 (float).
        chunk_rows: scan lines in a chunk.
        top: number of the first row.
    """

    header: bytes
    names: tuple[str, ...]
    size: tuple[int, int]
    sample_bytes: int
    chunk_rows: int
    top: int

    @property
    def line(self) -> int:
        """Bytes of a row."""
        return self.size[0] * len(self.names) * self.sample_bytes

    def chunks(self, file: int, start: int, stop: int) -> Iterator[tuple[memoryview, bool]]:
        """The chunks of rows start..stop (whole chunks) of an open file descriptor: inflated bytes, or as they are and True.

        A writer keeps a chunk as it is where zip would make it larger. Raises ValueError, struct.error, OSError, OverflowError
        or deflate.DeflateError on a damaged file (`damage`).
        """
        import deflate

        rows = range(start, stop, self.chunk_rows)
        table = os.pread(file, 8 * len(rows), len(self.header) + 8 * (start // self.chunk_rows))
        offsets = struct.unpack(f"<{len(rows)}Q", table)
        begin, last, most = min(offsets), max(offsets), self.line * self.chunk_rows
        _, size = struct.unpack("<ii", os.pread(file, 8, last))
        if not 0 < size <= most:
            raise ValueError("not a chunk")
        length = last + 8 + size - begin
        near = memoryview(os.pread(file, length, begin)) if length <= 2 * len(rows) * most else None  # one after another
        for row, offset in zip(rows, offsets):
            at, stored = (0, memoryview(os.pread(file, 8 + most, offset))) if near is None else (offset - begin, near)
            whole = min(self.chunk_rows, self.size[1] - row) * self.line
            said, size = struct.unpack_from("<ii", stored, at)
            packed = stored[at + 8 : at + 8 + size]
            if said != self.top + row or not 0 < size <= whole or len(packed) != size:
                raise ValueError("not a chunk")
            data = packed if size == whole else memoryview(deflate.zlib_decompress(packed, whole))
            if len(data) != whole:
                raise ValueError("a chunk is short")
            yield data, size == whole


@dataclass
class ZipExr:
    """An open file and its layout. Close `file`."""

    file: BinaryIO
    layout: ZipLayout

    def read(self, start: int, stop: int, place: NDArray[np.int64], out: NDArray[np.float32]) -> bool:
        """Rows start..stop (whole chunks) to out [rows, W, C], file channel c at out[..., place[c]]; False if corrupt."""
        from pipeline.formats.exr_kernels import place_floats, place_halves, undo_predictor

        layout = self.layout
        row = layout.size[0] * len(layout.names)
        stored = np.empty(layout.chunk_rows * layout.line // 2, np.uint16)
        wide = np.empty(row, np.float32)
        first = 0
        try:
            for data, plain in layout.chunks(self.file.fileno(), start, stop):
                words = np.frombuffer(data, np.uint16)
                if not plain:
                    words = stored[: len(data) // 2]
                    undo_predictor(np.frombuffer(data, np.uint8), words)
                rows = len(data) // layout.line
                part = out[first : first + rows]
                first += rows
                if layout.sample_bytes == 2:
                    place_halves(words.reshape(rows, row), wide, wide.view(np.uint32), place, part)
                else:
                    place_floats(words.view(np.float32).reshape(rows, row), place, part)
        except damage():
            return False
        return True


def damage() -> tuple[type[Exception], ...]:
    """Name the errors that reading the chunks of a damaged file raises.

    Returns:
        Exception types, for an `except`.
    """
    import deflate

    return ValueError, struct.error, OSError, OverflowError, deflate.DeflateError


def open_zip_exr(path: Path) -> ZipExr | None:
    """Open an EXR if it can be read directly: scan lines, zip, channels of one kind, whole.

    Args:
        path: the file.

    Returns:
        The open file, to be closed by the caller; None: leave it to OpenImageIO, which also says what is wrong with it.
    """
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
    typed, end = _attributes(file.read(LARGEST_HEADER))
    if not _well_formed(typed):
        return None  # OpenEXR may open such a file and then refuse its pixels
    attributes = {name: value for name, (_, value) in typed.items()}
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
    file.seek(0)
    names = tuple(name for name, _ in channels)
    return ZipExr(file, ZipLayout(file.read(8 + end), names, (width, height), SAMPLE_BYTES[kinds.pop()], rows, top))


def _well_formed(attributes: Mapping[str, tuple[str, bytes]]) -> bool:
    """Whether all required attributes are there, each of its type and size."""
    there = [(attributes[name], kind, size) for name, (kind, size) in REQUIRED.items() if name in attributes]
    return len(there) == len(REQUIRED) and all(t == kind and size in (None, len(value)) for (t, value), kind, size in there)


def _attributes(header: bytes) -> tuple[dict[str, tuple[str, bytes]], int]:
    """(type, value) by name, and where the header ends."""
    found: dict[str, tuple[str, bytes]] = {}
    at = 0
    while header[at]:
        name, at = _text(header, at)
        kind, at = _text(header, at)
        (size,) = struct.unpack_from("<i", header, at)
        found[name] = kind, header[at + 4 : at + 4 + size]
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
