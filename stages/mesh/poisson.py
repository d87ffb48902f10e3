"""Screened Poisson surface from the TSDF's vertices and baked normals: closed, smoother, guesses where nothing was seen."""

from __future__ import annotations

import numpy as np

from .clean import Mesh

LEAST_DENSITY_QUANTILE = 0.002  # vertices that almost no sample supports lie on balloons outside the object


def poisson_surface(mesh: Mesh, depth: int) -> Mesh:
    """Kazhdan and Hoppe 2013 at octree `depth`; one thread, because only that is repeatable."""
    import open3d as o3d

    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(mesh.vertices))
    cloud.normals = o3d.utility.Vector3dVector(mesh.attributes["normal"].astype(np.float64))
    surface, density = o3d.geometry.TriangleMesh.create_from_point_cloud_poisson(cloud, depth=depth, n_threads=1)
    supported = np.asarray(density) > np.quantile(np.asarray(density), LEAST_DENSITY_QUANTILE)
    low, high = mesh.vertices.min(0), mesh.vertices.max(0)
    margin = 0.02 * (high - low).max()
    vertices = np.asarray(surface.vertices)
    inside = ((vertices > low - margin) & (vertices < high + margin)).all(1) & supported
    faces = np.asarray(surface.triangles).astype(np.int64)
    return Mesh(vertices, faces[inside[faces].all(1)])
