"""Files that a C library takes for whole, or complains of by itself only: by their own structure, and by garbled names."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import BinaryIO

from pipeline.errors import UserError

PNG_END = b"IEND"
START_OF_SCAN, END_OF_IMAGE = 0xDA, b"\xff\xd9"
TAIL = 1 << 16
"""Bytes at a PNG's end in which its last chunk is looked for: some programs add a few of their own after it."""
OFFSETS_OF = {273: 279, 324: 325}
"""TIFF tags of where strips and tiles lie, and of their lengths."""
DIRECTORIES = (330, 34665)
SIZES = {3: 2, 4: 4, 13: 4}
MOST_DIRECTORIES = 64
LARGEST_HEADER = 1 << 20
"""Bytes of an EXR in which its header ends."""
BLANK = 64
"""Bytes of zeros that no image format begins with: DICOM has 128, and then no picture that is read here."""


def refuse_garbled_name(path: Path) -> None:
    """Raise UserError where a file's name is no text: libraries that want one refuse it with an exception of their own."""
    if any("\ud800" <= c <= "\udfff" for c in str(path)):
        raise UserError(path, "its name or its folder's is no text in UTF-8, which image libraries want", "rename it")


def refuse_blank(path: Path) -> None:
    """Raise UserError where a file begins with zeros, as no image does: a broken copy, which libraries read whole."""
    with path.open("rb") as file:
        if file.read(BLANK) == bytes(BLANK):
            raise UserError(path, f"is no image: it begins with {BLANK} zeros", "copy it again from its source")


def refuse_truncated(path: Path) -> None:
    """Refuse a PNG, JPEG, TIFF or DNG that ends before its pixels do; other files pass.

    Args:
        path: the file, which exists.

    Raises:
        UserError: it is truncated.
    """
    size = path.stat().st_size
    with path.open("rb") as file:
        head = file.read(8)
        if head == b"\x89PNG\r\n\x1a\n":
            file.seek(max(0, size - TAIL))
            short = PNG_END not in file.read()
        elif head[:3] == b"\xff\xd8\xff":
            short = not _jpeg_ends(file)
        elif head[:4] in (b"II*\0", b"MM\0*"):
            short = tiff_end(file, head, size) > size
        else:
            return
    if short:
        raise UserError(path, f"the file is truncated ({size} bytes)", "copy it again from its source")


def exr_chunks_in_place(path: Path, height: int, rows: int) -> bool:
    """Look whether the table of a scan-line EXR names every chunk where it lies: OpenEXR makes a lost one up without a word.

    Args:
        path: the file.
        height: of the image, whose first row is number 0.
        rows: scan lines in a chunk.

    Returns:
        Whether it does; False where the file ends before.
    """
    with path.open("rb") as file:
        head, at = file.read(LARGEST_HEADER), 8
        while at < len(head) and head[at]:
            kind = head.find(b"\0", at) + 1
            size = head.find(b"\0", kind) + 1
            at = size + 4 + int.from_bytes(head[size : size + 4], "little")
        first = range(0, height, rows)
        file.seek(at + 1)
        table = file.read(8 * len(first))
        if len(table) < 8 * len(first):
            return False
        for row, offset in zip(first, struct.unpack(f"<{len(first)}Q", table)):
            file.seek(min(offset, 1 << 62))
            if file.read(4) != struct.pack("<i", row):
                return False
    return True


def _jpeg_ends(file: BinaryIO) -> bool:
    """Whether an end of image follows a JPEG's samples, which libjpeg fills up with grey otherwise. True where its segments
    are not understood: its reader says why. A thumbnail's own end lies in a segment before, and programs add to the file's."""
    file.seek(2)
    while True:
        head = file.read(4)
        while head[:2] == b"\xff\xff":  # any number of these may stand before a marker
            head = head[1:] + file.read(1)
        if len(head) < 4:
            return False
        if head[0] != 0xFF:
            return True
        length = struct.unpack(">H", head[2:])[0]
        file.seek(length - 2, 1)
        if head[1] == START_OF_SCAN:
            return END_OF_IMAGE in file.read()


def tiff_end(file: BinaryIO, head: bytes, size: int) -> int:
    """The last byte + 1 that any directory, strip or tile of a TIFF reaches; what is not understood is left out."""
    order = "<" if head[:2] == b"II" else ">"
    todo, end = [struct.unpack(order + "I", head[4:])[0]], 8
    seen: set[int] = set()
    while todo and len(seen) < MOST_DIRECTORIES:
        at = todo.pop()
        if at in seen or at == 0:
            continue
        seen.add(at)
        if at + 2 > size:
            return at + 2
        file.seek(at)
        count = struct.unpack(order + "H", file.read(2))[0]
        table = file.read(12 * count + 4)
        if len(table) < 12 * count:
            return at + 2 + 12 * count
        tags: dict[int, tuple[int, ...]] = {}
        for k in range(count):
            tag, kind, number = struct.unpack(order + "HHI", table[12 * k : 12 * k + 8])
            if tag in (*OFFSETS_OF, *OFFSETS_OF.values(), *DIRECTORIES) and kind in SIZES:
                tags[tag], last = _numbers(file, order, kind, number, table[12 * k + 8 : 12 * k + 12])
                end = max(end, last)
        for offsets, lengths in OFFSETS_OF.items():
            end = max([end, *(a + b for a, b in zip(tags.get(offsets, ()), tags.get(lengths, ())))])
        todo += [a for tag in DIRECTORIES for a in tags.get(tag, ())]
        if len(table) == 12 * count + 4:
            todo.append(struct.unpack(order + "I", table[-4:])[0])
    return end


def _numbers(file: BinaryIO, order: str, kind: int, number: int, value: bytes) -> tuple[tuple[int, ...], int]:
    """A tag's unsigned numbers (none where the file ends before them), and where they end if they lie elsewhere."""
    end, length = 0, SIZES[kind] * number
    if length > 4:
        at = struct.unpack(order + "I", value)[0]
        file.seek(at)
        value, end = file.read(length), at + length
        if len(value) < length:
            return (), end
    return struct.unpack(f"{order}{number}{'H' if kind == 3 else 'I'}", value[:length]), end
