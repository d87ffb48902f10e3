"""A PLY file's bytes as its elements: the header, then rows in text or in binary of either byte order."""

from __future__ import annotations

import re
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

SCALARS = {
    "char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4", "float": "f4", "double": "f8",
    "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4", "float32": "f4", "float64": "f8",
}  # fmt: skip
"""numpy's codes of the types that a header may name; the second row is what newer programs write."""
BYTE_ORDERS = {"binary_little_endian": "<", "binary_big_endian": ">", "ascii": ""}


@dataclass(frozen=True)
class Property:
    """One property: numpy's code of its numbers, and of a list's length ("" where it is no list)."""

    name: str
    kind: str
    length: str = ""


@dataclass
class Element:
    """`count` rows of an element such as "vertex": `columns` [count] and `lists` (lengths [count], all numbers), by name."""

    name: str
    count: int
    properties: list[Property] = field(default_factory=list)
    columns: dict[str, NDArray] = field(default_factory=dict)
    lists: dict[str, tuple[NDArray[np.int64], NDArray]] = field(default_factory=dict)


class PlyFault(Exception):
    """Why bytes are no PLY: (fault, remedy)."""


COPY = "copy or export it again"
LONGEST_COUNT = 18
"""Digits of a number of rows: such files would be larger than any disk."""
LONGEST_NUMBER = 400
"""Characters of a number in text: the smallest double, written out, has 327."""


def parse(data: bytes) -> list[Element]:
    """All elements, filled. Raises PlyFault."""
    first = re.match(rb"ply[ \t]*(\r\n|\n|\r)", data)
    if first is None:
        raise PlyFault("the file is empty (0 bytes)" if not data else "is not a PLY file", COPY)
    end = re.search(rb"[\r\n]end_header[ \t]*" + first[1], data)
    if end is None:
        raise PlyFault("its header has no end", COPY)
    order, elements = _header(data[first.end() : end.start()])
    if order:
        at = end.end()
        for element in elements:
            at = _binary(element, data, at, order)
        return elements
    words = data[end.end() :].split()
    at = 0
    for element in elements:
        at = _text(element, words, at)
    return elements


def _header(head: bytes) -> tuple[str, list[Element]]:
    """Byte order ("" for text) and the elements, empty. Raises PlyFault."""
    order, elements, names = None, list[Element](), set[str]()
    for line in head.decode("latin-1").splitlines():
        words = line.split()
        match words:
            case [] | ["comment" | "obj_info", *_]:
                continue
            case ["format", name, _] if name in BYTE_ORDERS:
                order = BYTE_ORDERS[name]
                continue
            case ["element", name, number] if name not in names and number.isdecimal() and len(number) <= LONGEST_COUNT:
                elements.append(Element(name, int(number)))
                names.add(name)
                continue
            case ["property", *kinds, name] if elements:
                kinds = kinds[1:] if kinds[:1] == ["list"] and len(kinds) == 3 else kinds
                codes = [SCALARS[k] for k in kinds if k in SCALARS]
                if len(codes) == len(kinds) == (2 if words[1] == "list" else 1) and "f" not in "".join(codes[:-1]):
                    elements[-1].properties.append(Property(name, codes[-1], "".join(codes[:-1])))
                    continue
        raise PlyFault(f"its header has the line {line.strip()[:60]!r}, which PLY does not know", COPY)
    for element in elements:
        if len({p.name for p in element.properties}) < len(element.properties):
            raise PlyFault(f"its element {element.name} has two properties of one name", COPY)
    if order is None:
        raise PlyFault("its header names no format", COPY)
    return order, elements


def _binary(element: Element, data: bytes, at: int, order: str) -> int:
    """Fill an element from its bytes at `at`; returns where they end. Raises PlyFault."""
    lists = [p for p in element.properties if p.length]
    if not lists or not element.count:
        row = np.dtype([(p.name, order + p.kind) for p in element.properties if not p.length])
        rows = _rows(element, data, at, row)
        element.columns = {n: rows[n] for n in row.names or ()}
        element.lists = {p.name: (np.zeros(0, np.int64), np.zeros(0, p.kind)) for p in lists}
        return at + rows.nbytes
    alike = _binary_alike(element, data, at, order)
    return _binary_walk(element, data, at, order) if alike is None else alike


def _rows(element: Element, data: bytes, at: int, row: np.dtype) -> NDArray:
    have = (len(data) - at) // row.itemsize if row.itemsize else element.count
    if have < element.count:
        raise _short(element, have)
    return np.frombuffer(data, row, element.count, at) if row.itemsize else np.empty(0, row)


def _short(element: Element, have: int) -> PlyFault:
    return PlyFault(f"the file is truncated: {have} of {element.count} {element.name} rows", "copy it again from its source")


def _binary_alike(element: Element, data: bytes, at: int, order: str) -> int | None:
    """Fill it in one step where every list is as long as in the first row; None where that does not hold."""
    fields: list[tuple] = []
    here = at
    for p in element.properties:
        if not p.length:
            fields.append((p.name, order + p.kind))
            here += np.dtype(p.kind).itemsize
            continue
        size = np.dtype(p.length).itemsize
        if here + size > len(data):
            return None
        length = int(np.frombuffer(data, order + p.length, 1, here)[0])
        if length < 0 or length * np.dtype(p.kind).itemsize > len(data) - here - size:
            return None
        fields += [(f"{p.name} length", order + p.length), (p.name, order + p.kind, (length,))]
        here += size + length * np.dtype(p.kind).itemsize
    row = np.dtype(fields)
    if (len(data) - at) // row.itemsize < element.count:
        return None
    rows = np.frombuffer(data, row, element.count, at)
    for p in element.properties:
        if p.length and (rows[f"{p.name} length"] != rows[f"{p.name} length"][0]).any():
            return None
    element.columns = {p.name: rows[p.name] for p in element.properties if not p.length}
    element.lists = {
        p.name: (rows[f"{p.name} length"].astype(np.int64), rows[p.name].reshape(-1)) for p in element.properties if p.length
    }
    return at + rows.nbytes


def _binary_walk(element: Element, data: bytes, at: int, order: str) -> int:
    """Fill it row by row: lists of different lengths."""
    kinds = [(p, np.dtype(order + p.kind), np.dtype(order + p.length) if p.length else None) for p in element.properties]
    found: dict[str, list[bytes]] = {p.name: [] for p in element.properties}
    lengths: dict[str, list[int]] = {p.name: [] for p in element.properties if p.length}
    for row in range(element.count):
        for p, kind, length in kinds:
            count = 1
            if length is not None:
                count = int.from_bytes(
                    data[at : at + length.itemsize], "big" if order == ">" else "little", signed="i" in p.length
                )
                at += length.itemsize
                lengths[p.name].append(count)
            part = data[at : at + count * kind.itemsize]
            if count < 0 or at > len(data) or len(part) < count * kind.itemsize:
                raise _short(element, row)
            found[p.name].append(part)
            at += len(part)
    for p, kind, length in kinds:
        values = np.frombuffer(b"".join(found[p.name]), kind)
        if length is None:
            element.columns[p.name] = values
        else:
            element.lists[p.name] = np.array(lengths[p.name], np.int64), values
    return at


def _text(element: Element, words: list[bytes], at: int) -> int:
    """Fill an element from its words at `at`; returns where they end. Raises PlyFault."""
    found: dict[str, list[bytes]] = {p.name: [] for p in element.properties}
    lengths: dict[str, list[int]] = {p.name: [] for p in element.properties if p.length}
    width = len(element.properties)
    if not lengths:  # every row is as wide
        have = (len(words) - at) // width if width else element.count
        if have < element.count:
            raise _short(element, have)
        for k, p in enumerate(element.properties):
            found[p.name] = words[at + k : at + width * element.count : width]
        at += width * element.count
    else:
        for row in range(element.count):
            for p in element.properties:
                count = 1
                if p.length:
                    count = int(_numbers(words[at : at + 1], "i8")[0]) if at < len(words) else 1
                    lengths[p.name].append(count)
                    at += 1
                if count < 0 or at + count > len(words):
                    raise _short(element, row)
                found[p.name] += words[at : at + count]
                at += count
    for p in element.properties:
        values = _numbers(found[p.name], p.kind)
        if p.length:
            element.lists[p.name] = np.array(lengths[p.name], np.int64), values
        else:
            element.columns[p.name] = values
    return at


def _numbers(words: list[bytes], kind: str) -> NDArray:
    """Words as numbers; text may hold more digits than a float of 32 bits keeps, so floats have 64. Raises PlyFault."""
    if (longest := max(map(len, words), default=0)) > LONGEST_NUMBER:  # numpy would give every word as much room
        raise PlyFault(f"a word of {longest} characters stands where a number should", COPY)
    try:
        return np.array(words, dtype="S").astype(np.float64).astype("f8" if "f" in kind else kind)
    except ValueError:
        wrong = next((w for w in words if not _is_number(w)), b"")
        raise PlyFault(f"{wrong[:40].decode('latin-1')!r} stands where a number should", COPY) from None


def _is_number(word: bytes) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True
