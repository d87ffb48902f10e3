"""Wavefront OBJ with a material of the PBR keys that Blender, Maya and others read."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from pipeline.formats.images import write_exr

from .surface import Asset

NAME = "polarfield"


def write_obj(folder: Path, asset: Asset, maps: Sequence[str]) -> None:
    """asset.obj (metres, y up) and asset.mtl, whose textures lie in textures/.

    Numbers are EXR there: Blender 5.0 takes integer pictures of roughness and normals for sRGB ones, and knows a normal map by
    `map_Bump` alone; those that know `norm` take that one. The index of refraction is
    one number, and `map_Ks` scales what it reflects: a half of it leaves it as it is, as `Ks 0.5` does.
    """
    uv = np.stack([asset.uv[:, 0], 1 - asset.uv[:, 1]], -1)
    lines = ["# polarfield: metres, y up", "mtllib asset.mtl", f"o {NAME}"]
    lines += ["v {:.7g} {:.7g} {:.7g}".format(*p) for p in asset.position.tolist()]
    lines += ["vt {:.7g} {:.7g}".format(*p) for p in uv.tolist()]
    lines += ["vn {:.6f} {:.6f} {:.6f}".format(*n) for n in asset.normal.tolist()]
    lines += [f"usemtl {NAME}"]
    lines += ["f {0}/{0}/{0} {1}/{1}/{1} {2}/{2}/{2}".format(*f) for f in (asset.faces + 1).tolist()]
    (folder / "asset.obj").write_text("\n".join(lines) + "\n")
    ior, share = asset.reflectance()
    if share is not None:
        write_exr(folder / "textures" / "obj_specular.exr", {"Y": share[..., 0] / 2}, half=True)
    entries = [
        f"newmtl {NAME}", "Kd 1 1 1", "Ks 0.5 0.5 0.5", f"Ni {ior:.4f}", "illum 2", "Pm 0",
        "map_Kd textures/base_color.png", f"map_Pr textures/{asset.roughness_name}.exr", "norm textures/normal_map.exr",
        "map_Bump -bm 1 textures/normal_map.exr",
        *(["map_Ks textures/obj_specular.exr"] if share is not None else []),
    ]  # fmt: skip
    (folder / "asset.mtl").write_text("\n".join(entries) + "\n")
