"""The asset folder: one surface with textures, in every format, and asset.json that says what is in it."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .bake import Textured
from .blender import write_blender
from .glb import write_glb
from .lobes import GGX
from .materialx import write_materialx
from .mitsuba import write_mitsuba
from .obj import write_obj
from .surface import asset_from_world, in_metres
from .texture_files import write_textures
from .usdz import write_usdz

FORMATS: dict[str, tuple[str, ...]] = {
    "glb": ("asset.glb",),
    "usdz": ("asset.usdz",),
    "mtlx": ("asset.mtlx", "textures"),
    "obj": ("asset.obj", "asset.mtl", "textures"),
    "mitsuba": ("asset.xml", "asset.obj", "environment.exr", "textures"),
    "blender": ("blender.py", "asset.obj", "asset.mtl", "textures"),
}
"""The files of each format, in an asset's folder."""
CANNOT: dict[str, list[str]] = {
    "asset.glb": [
        "polarisation",
        "more than 8 bits",
        "transmission of the body into and out of it (base_color holds its mean)",
    ],
    "asset.usdz": ["polarisation", "more than 8 bits", "an index of refraction that varies (its median is kept)"],
    "asset.mtlx": ["polarisation", "the mesh: it is a material"],
    "asset.obj": ["polarisation", "an index of refraction that varies: its largest is kept, and map_Ks scales it", "occlusion"],
    "asset.xml": ["an index of refraction that varies: its median is kept, and the mirrored light is scaled"],
    "blender.py": ["polarisation"],
}


def write_asset(
    folder: Path,
    surface: Textured,
    up: str,
    unit_m: float | None,
    offset: NDArray[np.float64],
    environment: NDArray[np.float32] | None = None,
    facts: dict[str, Any] | None = None,
    done: Callable[[int], None] = lambda count: None,
    lobe: str = GGX,
) -> None:
    """Write a textured surface in every format, with asset.json.

    Args:
        folder: where; made when missing.
        surface: in world units.
        up: the capture's up axis.
        unit_m: metres per world unit; None: not known.
        offset: was taken off all world positions. [3]
        environment: light to start with, latitude-longitude, y up. [H, W, 3]
        facts: more entries of asset.json.
        done: told of each file.
        lobe: in which the roughness was fitted ("ggx", "beckmann", ...).

    Raises:
        UserError: a file cannot be written.
    """
    folder.mkdir(parents=True, exist_ok=True)
    asset = in_metres(surface, up, unit_m, lobe)
    names = write_textures(folder / "textures", asset.maps)
    writers: Sequence[Callable[[], None]] = (
        lambda: write_obj(folder, asset, names),
        lambda: write_glb(folder / "asset.glb", asset),
        lambda: write_usdz(folder / "asset.usdz", asset),
        lambda: write_materialx(folder / "asset.mtlx", asset, names),
        lambda: write_mitsuba(folder, asset, names, environment),
        lambda: write_blender(folder / "blender.py", asset, names),
    )
    for write in writers:
        write()
        done(1)
    height, width = asset.maps["albedo"].shape[:2]
    table = {
        "schema": 1,
        "axes": "y up, right-handed",
        "unit": "metre" if unit_m else "world unit (metres per unit are not known)",
        "unit_m": unit_m,
        "world_up": up,
        "asset_from_world": asset_from_world(up, unit_m).tolist(),
        "world_offset": [float(x) for x in offset],
        "texture_size": [width, height],
        "texel_m" if unit_m else "texel": surface.texel * (unit_m or 1.0),
        "guessed_share": round(surface.guessed, 5),
        "ior": round(asset.ior, 4),
        "lobe": lobe,
        "triangles": len(asset.faces),
        "textures": {name: f"textures/{name}.png" for name in names},
        "cannot_carry": CANNOT,
        **(facts or {}),
    }
    (folder / "asset.json").write_text(json.dumps(table, indent=1) + "\n")
