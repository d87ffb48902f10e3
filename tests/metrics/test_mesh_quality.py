"""Handles, pieces, crossings and inward area of surfaces, against Open3D's own and by hand; distances in millimetres."""

from __future__ import annotations

import numpy as np
import pytest

from pipeline.formats.ply import write_ply
from stages.metrics.mesh_figures import mesh_table
from stages.metrics.mesh_quality import crossing, quality, welded

open3d = pytest.importorskip("open3d")


def shape(name: str, *arguments: float) -> tuple[np.ndarray, np.ndarray]:
    made = getattr(open3d.geometry.TriangleMesh, f"create_{name}")(*arguments)
    return np.asarray(made.vertices), np.asarray(made.triangles).astype(np.int64)


def together(*parts: tuple[np.ndarray, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    before = np.cumsum([0, *(len(v) for v, _ in parts)])
    return np.concatenate([v for v, _ in parts]), np.concatenate([f + n for (_, f), n in zip(parts, before)])


def theirs(vertices: np.ndarray, faces: np.ndarray) -> set[int]:
    """Open3D's crossing triangles: every pair without a shared corner, one against the other."""
    mesh = open3d.geometry.TriangleMesh(
        open3d.utility.Vector3dVector(vertices), open3d.utility.Vector3iVector(faces.astype(np.int32))
    )
    return set(np.asarray(mesh.get_self_intersecting_triangles()).ravel().tolist())


@pytest.mark.parametrize(("offset", "crosses"), [(0.7, True), (2.5, False)])
def test_crossing_triangles_are_those_that_open3d_finds(offset, crosses):
    ball, ring = shape("sphere", 1.0, 9), shape("torus", 1.0, 0.35, 14, 9)
    rotated = ring[0] @ np.array([[0.8, 0.6, 0], [-0.6, 0.8, 0], [0, 0, 1]]) + [offset, 0.13, 0.21]
    vertices, faces = welded(*together(ball, (rotated, ring[1])))
    found = set(np.flatnonzero(crossing(vertices, faces)).tolist())
    assert found == theirs(vertices, faces) and bool(found) == crosses


def test_handles_and_pieces_are_counted_and_an_open_surface_has_no_genus():
    ball, ring = shape("sphere", 1.0, 9), shape("torus", 1.0, 0.35, 14, 9)
    moved = ring[0] + 5, ring[1]
    whole = quality(*together(ball, moved))
    assert (whole["genus"], whole["components"]) == (1, 2)
    assert whole["self_intersecting_pct"] == whole["inside_out_pct"] == 0
    assert quality(ball[0], ball[1][:-7])["genus"] is None


def test_corners_that_lie_at_one_place_are_one():
    vertices, faces = shape("sphere", 1.0, 9)
    apart = vertices[faces].reshape(-1, 3), np.arange(3 * len(faces)).reshape(-1, 3)
    assert quality(*apart) == pytest.approx(quality(vertices, faces))


def test_a_piece_that_is_turned_inside_out_counts_with_its_area():
    vertices, faces = shape("sphere", 1.0, 9)
    both = together((vertices, faces), (0.5 * vertices + 5, faces[:, ::-1]))
    assert quality(*both)["inside_out_pct"] == pytest.approx(100 * 0.25 / 1.25, rel=1e-6)


def test_distances_are_in_millimetres_where_the_unit_is_known(tmp_path):
    vertices, faces = shape("sphere", 1.0, 20)
    for path, scale in (("mesh.ply", 1.2), ("mesh_poisson.ply", 1.5), ("gt.ply", 1.0)):
        write_ply(tmp_path / path, dict(zip("xyz", (scale * vertices).astype(np.float32).T)), faces)
    known = mesh_table(tmp_path, tmp_path / "gt.ply", 4000, unit_m=0.1).as_json()
    assert known["accuracy_mm"] == pytest.approx(20.0, rel=0.05)
    assert known["accuracy_mm"] == pytest.approx(known["accuracy_pct"] / 100 * 200)
    assert known["poisson"]["completeness_mm"] == pytest.approx(50.0, rel=0.05)
    unknown = mesh_table(tmp_path, tmp_path / "gt.ply", 400).as_json()
    assert unknown["accuracy_mm"] is None and "unit_m" in unknown["why"]["accuracy_mm"]
