"""Screened Poisson surface from the TSDF's vertices and baked normals: closed, guesses where nothing was seen."""

from __future__ import annotations

import numpy as np

from pipeline.geometry.mesh import Mesh


def poisson_surface(mesh: Mesh, depth: int) -> Mesh:
    """Kazhdan and Hoppe 2013 at octree `depth`; one thread, because only that is repeatable."""
    import open3d as o3d

    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(mesh.vertices))
    cloud.normals = o3d.utility.Vector3dVector(mesh.attributes["normal"].astype(np.float64))
    surface, _ = o3d.geometry.TriangleMesh.create_from_point_cloud_poisson(cloud, depth=depth, n_threads=1)
    return Mesh(np.asarray(surface.vertices), np.asarray(surface.triangles).astype(np.int64))
