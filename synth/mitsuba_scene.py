"""Mitsuba scene pieces shared by the two captures: mesh, camera, rendering to arrays by channel name."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from .shape import Shape

# Mitsuba's pinhole looks along +z with x to the left; our OpenGL matrices look along -z with x to the right.
MITSUBA_FROM_OPENGL = np.diag([-1.0, 1.0, -1.0, 1.0])
GEOMETRY_SPP = 16  # samples a pixel of normals, depths and albedos, which carry no Monte Carlo noise


def load_mesh(shape: Shape, bsdf: dict[str, Any], textured: bool = True) -> Any:
    """Make a Mitsuba mesh with a shape's own normals.

    Args:
        shape: the surface.
        bsdf: Mitsuba's dictionary of the material.
        textured: keep the texture coordinates.

    Returns:
        The mesh.
    """
    import mitsuba as mi

    properties = mi.Properties()
    properties["bsdf"] = mi.load_dict(bsdf)
    size = len(shape.vertices), len(shape.faces)
    mesh = mi.Mesh("object", *size, has_vertex_normals=True, has_vertex_texcoords=textured, props=properties)
    params = mi.traverse(mesh)
    params["vertex_positions"] = shape.vertices.astype(np.float32).ravel()
    params["vertex_normals"] = shape.normals.astype(np.float32).ravel()
    if textured:
        params["vertex_texcoords"] = shape.uv.astype(np.float32).ravel()
    params["faces"] = shape.faces.astype(np.uint32).ravel()
    params.update()
    return mesh


def texture(albedo: NDArray[np.float32]) -> dict[str, Any]:
    """Describe a linear RGB texture to Mitsuba; row r covers v = 1 - (r + 1/2) / rows.

    Args:
        albedo: linear, 0..1. [H, W, 3]

    Returns:
        Mitsuba's dictionary; for one use only: a spectral variant converts the bitmap in place when it is loaded.
    """
    import mitsuba as mi

    return {"type": "bitmap", "bitmap": mi.Bitmap(np.ascontiguousarray(albedo[::-1])), "raw": False}


def sensor(opengl_camera_to_world: NDArray, width: int, height: int, focal_px: float) -> dict[str, Any]:
    """Describe a camera to Mitsuba: square pixels, centred principal point, box filter (no light leaks between pixels).

    Args:
        opengl_camera_to_world: rigid. [4, 4]
        width, height: pixels.
        focal_px: focal length, pixels.

    Returns:
        Mitsuba's dictionary.
    """
    import mitsuba as mi

    return {
        "type": "perspective",
        "fov_axis": "y",
        "fov": float(np.degrees(2 * np.arctan(height / 2 / focal_px))),
        "near_clip": 1e-3 * float(np.linalg.norm(opengl_camera_to_world[:3, 3])),
        "far_clip": 10 * float(np.linalg.norm(opengl_camera_to_world[:3, 3])),
        "to_world": mi.ScalarTransform4f(opengl_camera_to_world @ MITSUBA_FROM_OPENGL),
        "film": {"type": "hdrfilm", "width": width, "height": height, "pixel_format": "rgba", "rfilter": {"type": "box"}},
        "sampler": {"type": "multijitter"},
    }


def render(scene: Any, view: Any, integrator: dict[str, Any], seed: int, spp: int) -> dict[str, NDArray[np.float32]]:
    """Render an image with Mitsuba.

    Args:
        scene: Mitsuba's.
        view: its sensor.
        integrator: Mitsuba's dictionary.
        seed: of the sampling.
        spp: samples a pixel (Mitsuba keeps it in the sensor).

    Returns:
        The film's channels by name. [H, W] each

    Raises:
        RuntimeError: Mitsuba names another number of channels than it returns.
    """
    import mitsuba as mi

    loaded = mi.load_dict(integrator)
    image = np.array(mi.render(scene, sensor=view, integrator=loaded, seed=mi.UInt32(seed), spp=spp), dtype=np.float32)
    names = loaded.aov_names()
    if len(names) < image.shape[-1]:
        names = ["R", "G", "B", "A", *names]  # an integrator that also estimates radiance
    if len(names) != image.shape[-1]:
        raise RuntimeError(f"Mitsuba returned {image.shape[-1]} channels for {names}")
    return {name: np.ascontiguousarray(image[..., k]) for k, name in enumerate(names)}
