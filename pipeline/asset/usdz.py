"""USDZ with a UsdPreviewSurface (Pixar's own library writes and packs it)."""

from __future__ import annotations

import os
import shutil
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.errors import UserError
from pipeline.formats.images import srgb_encode, write_png

from .surface import Asset

EPOCH = 946684800  # 2000-01-01: the package keeps its files' times, and the clock would change its bytes


def write_usdz(path: Path, asset: Asset) -> None:
    """One package: metres, y up. Raises UserError when it cannot be written."""
    from pxr import Sdf

    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        pictures = _write_pictures(folder, asset)
        _write_stage(folder / "asset.usdc", asset, pictures)
        packed = folder / path.name
        writer: Any = Sdf.ZipFileWriter.CreateNew(str(packed))
        for file in ("asset.usdc", *sorted(pictures.values())):
            os.utime(folder / file, (EPOCH, EPOCH))
            writer.AddFile(str(folder / file), file)
        if not writer.Save():
            raise UserError(path, "cannot be written", "check that there is room, and its permissions")
        shutil.copyfile(packed, path)


def _write_pictures(folder: Path, asset: Asset) -> dict[str, str]:
    """8-bit PNG by map: USDZ of 2024 takes no 16-bit ones everywhere."""
    m = asset.maps
    images = {"base_color": srgb_encode(m["base_color"]), "normal": m["normal"] * 0.5 + 0.5}
    images |= {"roughness": m[asset.roughness_name], "occlusion": m["occlusion"]}
    for name, image in images.items():
        write_png(folder / f"{name}.png", image)
    return {name: f"{name}.png" for name in images}


def _write_stage(path: Path, asset: Asset, pictures: dict[str, str]) -> None:
    from pxr import Gf, Sdf, Usd, UsdGeom, UsdShade, Vt

    stage: Any = Usd.Stage.CreateNew(str(path))
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.y)
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    root = UsdGeom.Xform.Define(stage, "/asset")
    stage.SetDefaultPrim(root.GetPrim())
    mesh = UsdGeom.Mesh.Define(stage, "/asset/mesh")
    single = asset.position.astype(np.float32)
    mesh.CreatePointsAttr(Vt.Vec3fArray.FromNumpy(single))
    mesh.CreateExtentAttr([Gf.Vec3f(*map(float, single.min(0))), Gf.Vec3f(*map(float, single.max(0)))])
    mesh.CreateFaceVertexCountsAttr(Vt.IntArray.FromNumpy(np.full(len(asset.faces), 3, np.int32)))
    mesh.CreateFaceVertexIndicesAttr(Vt.IntArray.FromNumpy(asset.faces.astype(np.int32).ravel()))
    mesh.CreateNormalsAttr(Vt.Vec3fArray.FromNumpy(asset.normal.astype(np.float32)))
    mesh.SetNormalsInterpolation(UsdGeom.Tokens.vertex)
    mesh.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
    uv = np.stack([asset.uv[:, 0], 1 - asset.uv[:, 1]], -1).astype(np.float32)
    coordinates = UsdGeom.PrimvarsAPI(mesh).CreatePrimvar("st", Sdf.ValueTypeNames.TexCoord2fArray, UsdGeom.Tokens.vertex)
    coordinates.Set(Vt.Vec2fArray.FromNumpy(uv))
    material = _material(stage, asset.ior, pictures)
    UsdShade.MaterialBindingAPI.Apply(mesh.GetPrim()).Bind(material)
    stage.GetRootLayer().Save()


def _material(stage: Any, ior: float, pictures: dict[str, str]) -> Any:
    """A UsdPreviewSurface with its textures."""
    from pxr import Sdf, UsdShade

    types = Sdf.ValueTypeNames
    material = UsdShade.Material.Define(stage, "/asset/material")
    shader = UsdShade.Shader.Define(stage, "/asset/material/surface")
    shader.CreateIdAttr("UsdPreviewSurface")
    shader.CreateInput("ior", types.Float).Set(ior)
    shader.CreateInput("metallic", types.Float).Set(0.0)
    material.CreateSurfaceOutput().ConnectToSource(shader.ConnectableAPI(), "surface")
    reader = UsdShade.Shader.Define(stage, "/asset/material/coordinates")
    reader.CreateIdAttr("UsdPrimvarReader_float2")
    reader.CreateInput("varname", types.String).Set("st")
    at = reader.CreateOutput("result", types.Float2)
    inputs = {
        "base_color": ("diffuseColor", types.Color3f, "rgb", types.Float3, "sRGB"),
        "normal": ("normal", types.Normal3f, "rgb", types.Float3, "raw"),
        "roughness": ("roughness", types.Float, "r", types.Float, "raw"),
        "occlusion": ("occlusion", types.Float, "r", types.Float, "raw"),
    }
    for name, (entry, kind, channel, out, space) in inputs.items():
        texture = UsdShade.Shader.Define(stage, f"/asset/material/{name}")
        texture.CreateIdAttr("UsdUVTexture")
        texture.CreateInput("file", types.Asset).Set(Sdf.AssetPath(pictures[name]))
        texture.CreateInput("sourceColorSpace", types.Token).Set(space)
        texture.CreateInput("wrapS", types.Token).Set("repeat")
        texture.CreateInput("wrapT", types.Token).Set("repeat")
        if name == "normal":
            texture.CreateInput("scale", types.Float4).Set((2.0, 2.0, 2.0, 1.0))
            texture.CreateInput("bias", types.Float4).Set((-1.0, -1.0, -1.0, 0.0))
        texture.CreateInput("st", types.Float2).ConnectToSource(at)
        shader.CreateInput(entry, kind).ConnectToSource(texture.CreateOutput(channel, out))
    return material
