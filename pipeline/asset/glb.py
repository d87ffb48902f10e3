"""Binary glTF 2.0: mesh, tangents, textures and material in one file."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.formats.gltf import GltfParts
from pipeline.formats.images import srgb_encode

from .anisotropy import in_gltf
from .surface import Asset

LINEAR, LINEAR_MIPMAP, REPEAT = 9729, 9987, 10497


def write_glb(path: Path, asset: Asset) -> None:
    """One file: metres, y up. The index of refraction by KHR_materials_ior, where it varies KHR_materials_specular's colour."""
    parts = GltfParts()
    attributes = {
        "POSITION": parts.array(asset.position, "VEC3", bounds=True),
        "NORMAL": parts.array(_unit(asset.normal), "VEC3"),
        "TANGENT": parts.array(np.concatenate([_unit(asset.tangent[:, :3]), asset.tangent[:, 3:]], 1), "VEC4"),
        "TEXCOORD_0": parts.array(asset.uv, "VEC2"),
    }
    indices = parts.indices(asset.faces)
    material, extensions = _material(asset, parts)
    document = {
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, "name": "polarfield"}],
        "meshes": [{"primitives": [{"attributes": attributes, "indices": indices, "material": 0}]}],
        "materials": [material],
        "textures": [{"sampler": 0, "source": k} for k in range(len(parts.images))],
        "samplers": [{"magFilter": LINEAR, "minFilter": LINEAR_MIPMAP, "wrapS": REPEAT, "wrapT": REPEAT}],
        "extensionsUsed": extensions,
    }
    parts.write(path, document)


def _material(asset: Asset, parts: GltfParts) -> tuple[dict[str, Any], list[str]]:
    """The material, and the extensions that it uses."""
    m = asset.maps
    roughness, strength = m[asset.roughness_name], None
    if "anisotropy" in m:
        roughness, strength = in_gltf(roughness, m["anisotropy"])
    packed = np.concatenate([m["occlusion"], roughness, np.zeros_like(roughness)], -1)
    orm = parts.image(packed, "occlusion_roughness_metallic")
    ior, share = asset.reflectance()
    extensions: dict[str, Any] = {"KHR_materials_ior": {"ior": ior}}
    if share is not None:
        colour = np.repeat(srgb_encode(share), 3, -1)
        extensions["KHR_materials_specular"] = {"specularColorTexture": {"index": parts.image(colour, "specular_color")}}
    if strength is not None:
        direction = np.concatenate([m["anisotropy_direction"] * 0.5 + 0.5, strength], -1)
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


def _unit(vectors: NDArray) -> NDArray:
    return vectors / np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), 1e-20)
