"""A script for Blender: the asset with its Principled BSDF, under a map."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from .surface import Asset
from .texture_files import COLOURS

TEMPLATE = Path(__file__).with_name("blender_script.txt")
SOCKETS = {"base_color": "Base Color", "ior": "IOR", "anisotropy": "Anisotropic"}
"""The inputs of the Principled BSDF that the maps are for (PRF section 5: albedo, lobe and normals each from their own map)."""


def write_blender(path: Path, asset: Asset, maps: Sequence[str]) -> None:
    """blender.py: run it as `blender --python blender.py`, or with the module bpy; `-- --help` lists what it takes."""
    sockets = SOCKETS | {asset.roughness_name: "Roughness"}
    pictures = {sockets[name]: (name, name in COLOURS) for name in sockets if name in maps}
    entries = [f'    "{socket}": ("textures/{name}.exr", {colour}),' for socket, (name, colour) in pictures.items()]
    path.write_text(TEMPLATE.read_text().replace("#TEXTURES#", "\n".join(entries)))
