"""The asset's mesh and textures, as far as the viewer's page has room for them."""

from __future__ import annotations

import base64
import io
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pipeline.formats.gltf import GltfFile
from pipeline.formats.images import RGB, read_image, srgb_encode
from pipeline.formats.json_file import read_json

LONGEST = 1024
"""Texels along a texture in the page."""
JPEG_QUALITY = 95  # of the albedo, without subsampled colour; what is not a colour is a PNG


@dataclass(frozen=True)
class TexturedSurface:
    """position [W, 3] (world units, y up), normal [W, 3], tangent [W, 4], uv [W, 2] of textures from the top row down, faces
    [F, 3]; albedo [W, 3], roughness [W], ior [W] of the textures at the vertices; pictures: data: URIs by name."""

    position: NDArray[np.float64]
    normal: NDArray[np.float64]
    tangent: NDArray[np.float64]
    uv: NDArray[np.float64]
    faces: NDArray[np.int64]
    albedo: NDArray[np.float64]
    roughness: NDArray[np.float64]
    ior: NDArray[np.float64]
    pictures: dict[str, str]


def textured_surface(folder: Path, most: int) -> TexturedSurface | None:
    """The asset in a folder; None where there is none, or its mesh has more than `most` triangles. Raises UserError."""
    if not (folder / "asset.glb").is_file():
        return None
    file = GltfFile(folder / "asset.glb")
    primitive = file.document["meshes"][0]["primitives"][0]
    at = primitive["attributes"]
    faces = file.array(primitive["indices"]).astype(np.int64).reshape(-1, 3)
    if len(faces) > most or "TANGENT" not in at:
        return None
    position, normal, tangent, uv = (
        file.array(at[n]).astype(np.float64) for n in ("POSITION", "NORMAL", "TANGENT", "TEXCOORD_0")
    )
    unit = read_json(folder / "asset.json", "run the mesh stage again").get("unit_m") or 1.0
    sources = (("albedo", RGB), ("normal", RGB), ("roughness", ("Y",)), ("ior", ("Y",)))
    maps = {name: read_image(folder / "textures" / f"{name}.exr", channels) for name, channels in sources}
    height, width = maps["albedo"].shape[:2]
    column, row = (np.clip((uv[:, k] * n).astype(int), 0, n - 1) for k, n in ((0, width), (1, height)))
    found = {name: image[row, column].astype(np.float64) for name, image in maps.items()}
    step = -(-max(height, width) // LONGEST)
    pad = (-height % step, -width % step)
    return TexturedSurface(
        position / unit, normal, tangent, uv * (width / (width + pad[1]), height / (height + pad[0])), faces,
        found["albedo"], found["roughness"][:, 0], found["ior"][:, 0], _pictures(maps, step, pad),
    )  # fmt: skip


def _pictures(maps: dict[str, NDArray[np.float32]], step: int, pad: tuple[int, int]) -> dict[str, str]:
    """The textures as data: URIs, `step` texels a side in one."""

    def smaller(name: str) -> NDArray[np.float32]:
        image = np.pad(maps[name], ((0, pad[0]), (0, pad[1]), (0, 0)), mode="edge")
        height, width, count = image.shape
        return image.reshape(height // step, step, width // step, step, count).mean((1, 3))

    normal = smaller("normal")
    normal = normal / np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-6)
    surface = np.concatenate([normal[..., :2] / 2 + 0.5, smaller("roughness")], -1)
    return {"albedo": _uri(srgb_encode(smaller("albedo")), "JPEG"), "surface": _uri(surface, "PNG")}


def _uri(share: NDArray, kind: str) -> str:
    from PIL import Image

    stream = io.BytesIO()
    options = {"quality": JPEG_QUALITY, "subsampling": 0} if kind == "JPEG" else {"optimize": True}
    Image.fromarray(np.rint(np.clip(share, 0, 1) * 255).astype(np.uint8)).save(stream, kind, **options)
    return f"data:image/{kind.lower()};base64,{base64.b64encode(stream.getvalue()).decode()}"
