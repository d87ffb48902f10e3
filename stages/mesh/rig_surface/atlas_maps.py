"""All cameras' maps fused on the texels of the mesh's atlas, and the folder asset/ of a light stage."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pipeline.asset.asset import write_asset
from pipeline.asset.atlas import Atlas, Texels, texels_of, unwrap
from pipeline.asset.bake import GUESSED, Textured
from pipeline.asset.filling import nearest_texel, texture
from pipeline.asset.tangents import in_tangent_frame, vertex_tangents
from pipeline.engine.stage import StageRun
from pipeline.formats import dataset_files as files
from pipeline.geometry.mesh import Mesh, without_slivers
from pipeline.geometry.occluder import simplified

from ..clean import unfolded
from .sights import Sights
from .vertex_maps import SurfacePoints, camera_values, filled, fused_maps

Float = NDArray[np.float64]
TRIANGLES = 20_000  # of the asset, unless `decimate` is 0: its normal map holds the relief, and mesh.ply all of it
BLOCK = 1 << 19  # texels fused together: what eight cameras say of them takes 300 MB
FILES = 6  # formats, for the bar
STANDARD_DEVIATIONS = ("std_diffuse_normal", "std_diffuse_albedo", "std_specular_albedo", "std_sigma")
MOST_REFLECTED = 0.95  # reflectance at normal incidence beyond which no index of refraction is of use
FACTS = {
    "detail": "maps",
    "reflectance": "albedo and specular as the lobe of `lobe` with sigma_x and sigma_y has them, measured under its lights; "
    "base_color is the albedo over what the coat of that reflectance lets through, and ior the index that reflects as much",
    "anisotropy": "1 - sigma_y / sigma_x; tangent: direction of sigma_x in the frame of the normal map, 0 where there is none",
}


def write_rig_asset(run: StageRun, mesh: Mesh, sights: Sights, slack: float, footprint: float, lobe: str) -> None:
    """Fuse the maps on an atlas of `mesh` (with its fused attributes) and write asset/. Raises UserError.

    slack: what a camera sees farther off is another surface; footprint: a pixel's width on the object (world units).
    """
    p = run.parameters
    coarse = unfolded(without_slivers(Mesh(*simplified(mesh.vertices, mesh.faces, TRIANGLES)))) if p.decimate else mesh
    atlas = unwrap(coarse.vertices, coarse.faces, p.texel_px * footprint, p.max_texture)
    texels = texels_of(atlas)
    position = coarse.vertices[atlas.source]
    normal = unit(on_surface(mesh, sights, position, mesh.attributes["normal"])[1])
    tangent = vertex_tangents(position, normal, atlas)
    frame = (texels.of(normal, atlas.faces), texels.of(tangent, atlas.faces))
    shading = np.concatenate([mesh.normals(), mesh.attributes["normal"], mesh.attributes["occlusion"][:, None]], 1)
    place, carried = on_surface(mesh, sights, texels.of(position, atlas.faces), shading)
    points = SurfacePoints(place, unit(carried[:, :3]))
    found = fused_on(points, sights, slack, run)
    seen = found["coverage"] > 0
    layers = layers_of(filled(points.position, found, unit(carried[:, 3:6])), *frame)
    layers["occlusion"] = carried[:, 6:].astype(np.float32)
    maps = in_textures(layers, np.where(seen, 1.0, GUESSED), texels, atlas)
    guessed = 1 - float(seen.mean())
    surface = Textured(position, normal, tangent, atlas.faces, atlas.uv, maps, p.texel_px * footprint, guessed)
    with run.progress.bar("asset", total=FILES, unit="files") as bar:
        unit_m = run.capture.config.unit_m
        write_asset(
            run.output / files.ASSET, surface, run.capture.up, unit_m, np.zeros(3), facts=FACTS, done=bar.advance, lobe=lobe
        )
    run.note("texture_size", [atlas.width, atlas.height])
    run.note("texture_guessed", round(guessed, 5))


def on_surface(mesh: Mesh, sights: Sights, points: NDArray, values: NDArray) -> tuple[Float, Float]:
    """The places on the dense mesh closest to points [N, 3], and its vertices' values [V, C] there."""
    near = sights.solid.closest(points)
    carried = np.zeros((len(points), values.shape[1]))
    for k in range(3):
        carried += near.weights[:, k, None] * values[mesh.faces[near.triangle, k]]
    return near.position.astype(np.float64), carried


def fused_on(points: SurfacePoints, sights: Sights, slack: float, run: StageRun) -> dict[str, NDArray]:
    """`fused_maps` of any number of points, block by block: memory does not grow with the texture's detail."""
    starts = range(0, len(points.position), BLOCK)
    parts = []
    with run.progress.bar("textures", total=len(starts) * len(sights), unit="views") as bar:
        for start in starts:
            own = SurfacePoints(*(values[start : start + BLOCK] for values in (points.position, points.normal)))
            values = []
            for sight in sights:
                values.append(camera_values(sight, own, slack))
                bar.advance(1)
            parts.append(fused_maps(values, own.normal))
    return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}


def layers_of(found: dict[str, NDArray], normal: NDArray, tangent: NDArray) -> dict[str, NDArray]:
    """Textures' values [T, C] by name from fused attributes; normal [T, 3], tangent [T, 4]: the mesh's frame at the texels."""
    local = unit(in_tangent_frame(unit(found["normal"]), normal, tangent))
    large, small = np.maximum(found["sigma"], 0).T
    reflected = np.clip(found["specular"], 0, MOST_REFLECTED)
    root = np.sqrt(reflected)
    along = in_tangent_frame(found["tangent"], normal, tangent)
    flat = unit(np.concatenate([along[:, :2], np.zeros((len(along), 1))], 1))
    lobed = large > 0
    out = {
        "albedo": found["albedo"], "base_color": np.clip(found["albedo"] / (1 - reflected[:, None]), 0, 1), "normal": local,
        "roughness": np.where(lobed, (large * small) ** 0.25, 1.0), "specular": reflected, "ior": (1 + root) / (1 - root),
        "sigma_x": large, "sigma_y": small, "anisotropy": np.where(lobed, 1 - small / np.maximum(large, 1e-9), 0.0),
        "tangent": flat, "anisotropy_direction": flat[:, :2],
        **{name: found[name] for name in STANDARD_DEVIATIONS},
    }  # fmt: skip
    out["anisotropy"] *= np.linalg.norm(flat, axis=1)  # without a direction there is none to tell
    return {name: np.asarray(values, np.float32).reshape(len(large), -1) for name, values in out.items()}


def in_textures(layers: dict[str, NDArray], coverage: Float, texels: Texels, atlas: Atlas) -> dict[str, NDArray[np.float32]]:
    """The layers as textures [H, W, C]; `coverage` [T] is 0 beside the charts, all else their nearest texel's."""
    shape = (atlas.height, atlas.width)
    nearest = nearest_texel(texels.index, shape)
    maps = {name: texture(values, texels.index, nearest, shape) for name, values in layers.items()}
    flat = np.zeros(atlas.width * atlas.height, np.float32)
    flat[texels.index] = coverage
    return {**maps, "coverage": flat.reshape(*shape, 1)}


def unit(vectors: NDArray) -> NDArray:
    """Vectors [N, 3] of unit length, 0 where they have none."""
    length = np.linalg.norm(vectors, axis=1, keepdims=True)
    return np.divide(vectors, length, out=np.zeros_like(vectors), where=length > 1e-9)
