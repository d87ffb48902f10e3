"""Multi-view capture: full-Stokes EXR + transforms.json + masks + gt/, as a spectral polarised path tracer sees it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from pipeline.formats.backdrop import grown
from pipeline.formats.images import STOKES, read_image, write_exr, write_png, write_rgb
from pipeline.formats.ply import write_ply
from pipeline.geometry.cameras import Camera, camera_from_opengl

from . import mitsuba_scene
from .environments import ENVIRONMENTS
from .orbit import look_at, orbit
from .print import printed
from .seen_texture import seen_texture
from .shape import Shape, bowl, glaze, vase

ALPHA = 0.15  # Beckmann roughness
IOR = 1.5
DISTANCE = 5.0  # of a shape 2 units high
HALF_FIELD_DEG = 14.5
BOUNCES = 4
WHITE, WHITE_BOUNCES = 0.9, 16  # of the bowl: half of what meets its inside leaves it each time
RELIGHT_EVERY = 4  # every how many-th view has a truth under the other environment
TRAINED, RELIT = "meadow", "studio"
Subject = Literal["vase", "bowl", "printed"]


def make(output: Path, size: int = 96, views: int = 16, spp: int = 144, seed: int = 0, subject: Subject = "vase") -> None:
    """Write a multi-view capture.

    Args:
        output: folder.
        size: of the images, pixels.
        views: how many.
        spp: samples a pixel (1.3 s a view for 144 at 96x96 on two cores).
        seed: of the sampling.
        subject: the glazed vase; "bowl": a bowl of albedo WHITE, which lights itself; "printed": the vase with a printed label,
            and the true albedo of every view.
    """
    import mitsuba as mi

    mi.set_variant("scalar_spectral_polarized")
    focal = size / 2 / np.tan(np.radians(HALF_FIELD_DEG))
    poses = [look_at(p) for p in orbit(views, DISTANCE, -8, 62)]
    white = subject == "bowl"
    shape, bounces = (bowl(), WHITE_BOUNCES) if white else (vase(), BOUNCES)
    albedo = printed()[::-1] if subject == "printed" else glaze()
    truth = output / "gt"
    write_rgb(truth / "env.hdr", ENVIRONMENTS[TRAINED](128))
    write_rgb(output / "envmaps" / f"{RELIT}.hdr", ENVIRONMENTS[RELIT](128))
    write_mesh(truth / "mesh.ply", shape)
    diffuse = {"type": "rgb", "value": [WHITE] * 3} if white else {"type": "texture"}
    material = {"alpha": ALPHA, "ior": IOR, "diffuse": diffuse}
    (truth / "material.json").write_text(json.dumps(material, indent=1) + "\n")
    _write_transforms(output / "transforms.json", poses, size, focal)

    colour = {"type": "rgb", "value": [WHITE] * 3} if white else mitsuba_scene.texture(albedo)
    plastic = {"type": "pplastic", "diffuse_reflectance": colour, "alpha": ALPHA, "int_ior": IOR}
    mesh = mitsuba_scene.load_mesh(shape, plastic)
    lit = _scene(mesh, truth / "env.hdr")
    relit = _scene(mesh, output / "envmaps" / f"{RELIT}.hdr")
    for index, pose in enumerate(poses):
        name = f"{index:03d}"
        view = mi.load_dict(mitsuba_scene.sensor(pose, size, size, focal))
        film = _stokes(lit, view, seed + index, spp, bounces)
        write_exr(output / "images" / f"{name}.exr", {k: film[k] for k in STOKES}, half=True)
        write_png(output / "masks" / f"{name}.png", film["A"])
        _write_geometry(truth, name, lit, view, pose, seed + index)
        if subject == "printed":
            camera = Camera(size, size, focal, focal, size / 2, size / 2, camera_from_opengl(pose))
            _write_material(truth / "material" / f"{name}.exr", shape, albedo, camera)
        if index % RELIGHT_EVERY == 0:
            other = _stokes(relit, view, seed + views + index, spp, bounces)
            write_exr(truth / "relight" / RELIT / f"{name}.exr", {k: other[k] for k in STOKES}, half=True)


def _scene(mesh: Any, environment: Path) -> Any:
    import mitsuba as mi

    light = {"type": "envmap", "bitmap": mi.Bitmap(read_image(environment, ("R", "G", "B")))}  # as stored: RGBE
    return mi.load_dict({"type": "scene", "object": mesh, "environment": light})


def _stokes(lit: Any, view: Any, seed: int, spp: int, bounces: int) -> dict[str, NDArray[np.float32]]:
    path = {"type": "path", "max_depth": bounces, "hide_emitters": True}
    return mitsuba_scene.render(lit, view, {"type": "stokes", "integrator": path}, seed, spp)


def _write_geometry(truth: Path, name: str, lit: Any, view: Any, pose: NDArray, seed: int) -> None:
    """Shading normals (world) and camera depths, averaged over the pixel's covered part."""
    film = mitsuba_scene.render(
        lit, view, {"type": "aov", "aovs": "n:sh_normal,p:position,d:depth"}, seed, mitsuba_scene.GEOMETRY_SPP
    )
    normal = np.stack([film[f"n.{c}"] for c in "XYZ"], -1)
    length = np.linalg.norm(normal, axis=-1, keepdims=True)
    normal = np.divide(normal, length, out=np.zeros_like(normal), where=length > 0)
    write_exr(truth / "normal" / f"{name}.exr", {c: normal[..., k] for k, c in enumerate("XYZ")}, half=True)
    to_camera = camera_from_opengl(pose)
    # The mean position is short by the coverage, which a pixel wholly inside has as 1; keep only those.
    covered = film["d.T"] > 0
    inside = covered & ~_touches(~covered)
    point = np.stack([film[f"p.{c}"] for c in "XYZ"], -1)
    depth = point @ to_camera[2, :3] + to_camera[2, 3]
    write_exr(truth / "depth" / f"{name}.exr", {"Z": np.where(inside, depth, 0)})


def _write_material(path: Path, shape: Shape, albedo: NDArray[np.float32], camera: Camera) -> None:
    """Albedo, roughness and index of refraction of what each pixel shows; 0 beside the object."""
    uv = np.stack([shape.uv[:, 0], 1 - shape.uv[:, 1]], -1)  # as `mitsuba_scene.texture` lays it on
    colour, covered = seen_texture(shape.vertices, shape.faces, uv, albedo, camera)
    channels = {f"albedo.{c}": colour[..., k] for k, c in enumerate("RGB")}
    there = (covered > 0).astype(np.float32)
    write_exr(path, {**channels, "roughness": there * np.sqrt(ALPHA), "ior": there * IOR}, half=True)


def _touches(empty: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Pixels that are empty or have an empty neighbour."""
    return grown(np.pad(empty, 1, constant_values=True))[1:-1, 1:-1]


def _write_transforms(path: Path, poses: list[NDArray], size: int, focal: float) -> None:
    frames = [
        {"file_path": f"images/{i:03d}.exr", "mask_path": f"masks/{i:03d}.png", "transform_matrix": pose.tolist()}
        for i, pose in enumerate(poses)
    ]
    shared = {"camera_model": "OPENCV", "fl_x": focal, "fl_y": focal, "cx": size / 2, "cy": size / 2, "w": size, "h": size}
    path.write_text(json.dumps({**shared, "frames": frames}, indent=1) + "\n")


def write_mesh(path: Path, shape: Shape) -> None:
    """The shape as an ASCII PLY triangle mesh."""
    columns = np.c_[shape.vertices, shape.normals].T
    write_ply(path, dict(zip(("x", "y", "z", "nx", "ny", "nz"), columns)), shape.faces, text=True)
