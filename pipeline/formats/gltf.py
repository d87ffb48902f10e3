"""Binary glTF 2.0 (Khronos' specification): the container, and arrays, indices and pictures in it.

Two chunks of a few tables: a library would take as many lines to fill in, and knows none of the newer extensions.
"""

from __future__ import annotations

import json
import struct
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import UserError
from pipeline.formats.images import write_png

MAGIC, VERSION, JSON_CHUNK, BINARY_CHUNK = 0x46546C67, 2, 0x4E4F534A, 0x004E4942
FLOAT, UNSIGNED_INT, UNSIGNED_SHORT = 5126, 5125, 5123
VERTICES, INDICES = 34962, 34963


class GltfParts:
    """The binary chunk as it grows, and the tables that say what lies where in it."""

    def __init__(self) -> None:
        self.data = bytearray()
        self.views: list[dict[str, Any]] = []
        self.accessors: list[dict[str, Any]] = []
        self.images: list[dict[str, Any]] = []

    def _view(self, content: bytes, target: int | None = None) -> int:
        view: dict[str, Any] = {"buffer": 0, "byteOffset": len(self.data), "byteLength": len(content)}
        self.views.append(view | ({} if target is None else {"target": target}))
        self.data += content + bytes(-len(content) % 4)
        return len(self.views) - 1

    def array(self, values: NDArray, kind: str, bounds: bool = False) -> int:
        """An accessor of float vectors [N, C], or of numbers [N] (kind SCALAR)."""
        single = np.ascontiguousarray(values, "<f4")
        limits = {"min": single.min(0).tolist(), "max": single.max(0).tolist()} if bounds else {}
        view = self._view(single.tobytes(), VERTICES)
        self.accessors.append({"bufferView": view, "componentType": FLOAT, "count": len(single), "type": kind, **limits})
        return len(self.accessors) - 1

    def indices(self, faces: NDArray) -> int:
        """An accessor of vertex numbers, as short as they can be."""
        short = faces.max() < 65535
        flat = np.ascontiguousarray(faces.ravel(), "<u2" if short else "<u4")
        view = self._view(flat.tobytes(), INDICES)
        kind = UNSIGNED_SHORT if short else UNSIGNED_INT
        self.accessors.append({"bufferView": view, "componentType": kind, "count": flat.size, "type": "SCALAR"})
        return len(self.accessors) - 1

    def image(self, encoded: NDArray, name: str) -> int:
        """A texture from values [H, W, 3] in 0..1."""
        view = self._view(png_bytes(encoded))
        self.images.append({"bufferView": view, "mimeType": "image/png", "name": name})
        return len(self.images) - 1

    def write(self, path: Path, document: dict[str, Any]) -> None:
        """Write a .glb: `document` with the tables that are gathered here."""
        tables: dict[str, Any] = {"accessors": self.accessors, "bufferViews": self.views, "images": self.images}
        whole = {
            "asset": {"version": "2.0", "generator": "polarfield"},
            **document,
            **{name: table for name, table in tables.items() if table},
            "buffers": [{"byteLength": len(self.data)}],
        }
        text = json.dumps(whole, separators=(",", ":")).encode()
        text += b" " * (-len(text) % 4)
        size = 12 + 8 + len(text) + 8 + len(self.data)
        head = struct.pack("<III", MAGIC, VERSION, size) + struct.pack("<II", len(text), JSON_CHUNK)
        path.write_bytes(head + text + struct.pack("<II", len(self.data), BINARY_CHUNK) + bytes(self.data))


class GltfFile:
    """A binary glTF read back.

    Fields:
        document: its JSON.
    """

    def __init__(self, path: Path) -> None:
        """Read it whole.

        Args:
            path: a .glb.

        Raises:
            UserError: it is none.
        """
        data = path.read_bytes()
        try:
            size, kind = struct.unpack_from("<II", data, 12)
            if struct.unpack_from("<I", data)[0] != MAGIC or kind != JSON_CHUNK:
                raise ValueError("no glTF")
            self.document: dict[str, Any] = json.loads(data[20 : 20 + size])
            self._binary = data[28 + size :]
        except (struct.error, ValueError) as error:
            raise UserError(path, f"is no binary glTF ({error})", "run the stage that made it again") from error

    def array(self, index: int) -> NDArray:
        """The values [N, C] of an accessor (floats, or unsigned 16 or 32 bits), [N] of one of numbers."""
        accessor = self.document["accessors"][index]
        kind = np.dtype({FLOAT: "<f4", UNSIGNED_INT: "<u4", UNSIGNED_SHORT: "<u2"}[accessor["componentType"]])
        width = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}[accessor["type"]]
        start = self.document["bufferViews"][accessor["bufferView"]].get("byteOffset", 0)
        values = np.frombuffer(self._binary, kind, accessor["count"] * width, start)
        return values if width == 1 else values.reshape(-1, width)


def png_bytes(encoded: NDArray) -> bytes:
    """An 8-bit PNG of values [H, W, C] in 0..1, as bytes."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "texture.png"
        write_png(path, encoded)
        return path.read_bytes()
