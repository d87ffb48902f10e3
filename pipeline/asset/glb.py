"""Binary glTF 2.0 (Khronos' specification): mesh, tangents, textures and material in one file.

Two chunks of a few tables: a library would take as many lines to fill in, and knows none of the material extensions.
"""

from __future__ import annotations

import json
import struct
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.formats.images import srgb_encode, write_png

from .surface import Asset

MAGIC, VERSION, JSON_CHUNK, BINARY_CHUNK = 0x46546C67, 2, 0x4E4F534A, 0x004E4942
FLOAT, UNSIGNED_INT, UNSIGNED_SHORT = 5126, 5125, 5123
VERTICES, INDICES = 34962, 34963
LINEAR, LINEAR_MIPMAP, REPEAT = 9729, 9987, 10497
FLAT = 1e-3  # a map that varies by less is a number


def write_glb(path: Path, asset: Asset) -> None:
    """One file: metres, y up. The index of refraction by KHR_materials_ior, where it varies KHR_materials_specular's colour."""
    parts = _Parts()
    attributes = {
        "POSITION": parts.array(asset.position, "VEC3", bounds=True),
        "NORMAL": parts.array(_unit(asset.normal), "VEC3"),
        "TANGENT": parts.array(np.concatenate([_unit(asset.tangent[:, :3]), asset.tangent[:, 3:]], 1), "VEC4"),
        "TEXCOORD_0": parts.array(asset.uv, "VEC2"),
    }
    indices = parts.indices(asset.faces)
    material, extensions = _material(asset, parts)
    document = {
        "asset": {"version": "2.0", "generator": "polarfield"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, "name": "polarfield"}],
        "meshes": [{"primitives": [{"attributes": attributes, "indices": indices, "material": 0}]}],
        "materials": [material],
        "textures": [{"sampler": 0, "source": k} for k in range(len(parts.images))],
        "images": parts.images,
        "samplers": [{"magFilter": LINEAR, "minFilter": LINEAR_MIPMAP, "wrapS": REPEAT, "wrapT": REPEAT}],
        "accessors": parts.accessors,
        "bufferViews": parts.views,
        "buffers": [{"byteLength": len(parts.data)}],
        "extensionsUsed": extensions,
    }
    text = json.dumps(document, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    whole = 12 + 8 + len(text) + 8 + len(parts.data)
    head = struct.pack("<III", MAGIC, VERSION, whole) + struct.pack("<II", len(text), JSON_CHUNK)
    path.write_bytes(head + text + struct.pack("<II", len(parts.data), BINARY_CHUNK) + bytes(parts.data))


def _material(asset: Asset, parts: _Parts) -> tuple[dict[str, Any], list[str]]:
    """The material, and the extensions that it uses."""
    m = asset.maps
    packed = np.concatenate([m["occlusion"], m["roughness"], np.zeros_like(m["roughness"])], -1)
    orm = parts.image(packed, "occlusion_roughness_metallic")
    seen = m["coverage"][..., 0] > 0
    reflectance = np.where(seen[..., None], m["specular"], np.median(m["specular"][seen]))
    most = float(reflectance.max())
    root = np.sqrt(most)
    extensions: dict[str, Any] = {"KHR_materials_ior": {"ior": float((1 + root) / (1 - root))}}
    if float(np.ptp(reflectance)) > FLAT * most:
        share = np.repeat(srgb_encode(reflectance / most), 3, -1)
        extensions["KHR_materials_specular"] = {"specularColorTexture": {"index": parts.image(share, "specular_color")}}
    if "anisotropy" in m:
        direction = np.concatenate([m["anisotropy_direction"] * 0.5 + 0.5, m["anisotropy"]], -1)
        texture = {"index": parts.image(direction, "anisotropy")}
        extensions["KHR_materials_anisotropy"] = {"anisotropyStrength": 1.0, "anisotropyTexture": texture}
    material = {
        "name": "polarfield",
        "pbrMetallicRoughness": {
            "baseColorTexture": {"index": parts.image(srgb_encode(m["base_color"]), "base_color")},
            "metallicRoughnessTexture": {"index": orm},
            "metallicFactor": 0.0,
            "roughnessFactor": 1.0,
        },
        "normalTexture": {"index": parts.image(m["normal"] * 0.5 + 0.5, "normal")},
        "occlusionTexture": {"index": orm},
        "extensions": extensions,
    }
    return material, sorted(extensions)


class _Parts:
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
        """An accessor of float vectors [N, C]."""
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


def png_bytes(encoded: NDArray) -> bytes:
    """An 8-bit PNG of values [H, W, C] in 0..1, as bytes."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "texture.png"
        write_png(path, encoded)
        return path.read_bytes()


def _unit(vectors: NDArray) -> NDArray:
    return vectors / np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), 1e-20)
