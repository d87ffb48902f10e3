"""A known shape in the fits: near lights stand where they are for each pixel, and what the object hides is dark."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from pipeline.errors import UserError
from pipeline.formats.ply import write_ply
from pipeline.geometry.cameras import Camera, camera_from_opengl
from pipeline.rig.light_table import LightTable
from pipeline.rig.solid_angles import solid_angles
from stages.olat.known_geometry import KnownGeometry, geometry_file, nearest_points
from stages.olat.pixel_fit.many_pixels import fit
from stages.olat.pixel_fit.result_layout import map_slices
from stages.olat.reading.frame_reader import Samples
from synth.olat_pixels import angle_deg, rig_of, unit
from synth.orbit import look_at

RADIUS, SIZE = 1.0, 24


def sphere(fine: int = 60, centre: tuple[float, float, float] = (0, 0, 0)) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and triangles of a ball of radius 1."""
    theta, phi = np.meshgrid(np.linspace(0, np.pi, fine + 1), np.linspace(0, 2 * np.pi, 2 * fine + 1), indexing="ij")
    points = np.stack([np.sin(theta) * np.cos(phi), np.cos(theta), np.sin(theta) * np.sin(phi)], -1).reshape(-1, 3)
    row, column = np.divmod(np.arange(fine * 2 * fine), 2 * fine)
    a = row * (2 * fine + 1) + column
    faces = np.concatenate(
        [np.stack([a, a + 1, a + 2 * fine + 1], -1), np.stack([a + 1, a + 2 * fine + 2, a + 2 * fine + 1], -1)]
    )
    return RADIUS * points + centre, faces


def written(path, *solids) -> KnownGeometry:
    vertices, faces, count = [], [], 0
    for v, f in solids:
        vertices.append(v)
        faces.append(f + count)
        count += len(v)
    whole = np.concatenate(vertices)
    write_ply(path, dict(zip("xyz", whole.T.astype(np.float32))), np.concatenate(faces))
    return KnownGeometry(path)


@pytest.fixture
def camera() -> Camera:
    return Camera(SIZE, SIZE, 60.0, 60.0, SIZE / 2, SIZE / 2, camera_from_opengl(look_at(np.array([0.0, 0.0, 6.0]))))


def seen(camera: Camera) -> tuple[np.ndarray, np.ndarray]:
    """Directions to the camera [P, 3] and points [P, 3] of the pixels that show the ball about the origin."""
    rays = camera.rays().reshape(-1, 3)
    along = rays @ camera.centre
    root = along**2 - (camera.centre @ camera.centre - RADIUS**2)
    on = root > 0.02
    return -rays[on], camera.centre + rays[on] * (-along - np.sqrt(np.maximum(root, 0)))[on, None]


@pytest.mark.slow
def test_near_lights_are_taken_from_the_surface(camera, settings, tmp_path):
    """Four radii away a light's direction differs by 14 degrees over the ball."""
    geometry = written(tmp_path / "ball.ply", sphere())
    toward, points = seen(camera)
    normal = points / RADIUS
    directions = rig_of(160).directions
    rig = LightTable(directions, 4 * RADIUS * directions, np.ones(160), solid_angles(directions))
    away = rig.positions[:, None] - points
    square = (away**2).sum(-1)
    cosine = np.maximum((unit(away) * normal).sum(-1), 0)
    light = 0.5 * cosine * (4 * RADIUS) ** 2 / square
    cross = np.repeat((light / 2)[..., None], 3, -1).astype(np.float32)
    samples = Samples(None, cross, cross)  # a matte ball
    places = nearest_points(camera, toward)
    before, _ = fit(cross, cross, toward, rig, settings, "float32", places)
    used, view, places = geometry.applied(samples, camera, toward, rig, places, (0, len(toward)))
    after, _ = fit(used.cross, used.parallel, view, rig, settings, "float32", places)
    at = map_slices()["diffuse_normal"]
    rough, fine = (np.median(angle_deg(rows[:, at], normal)) for rows in (before, after))
    assert fine < 0.3 and rough > 5 * fine
    albedo = np.abs(after[:, map_slices()["diffuse_albedo"]] / 0.5 - 1)
    assert np.median(albedo) < 0.01


def test_what_the_object_hides_is_dark_and_nothing_else_is(camera, tmp_path):
    toward, points = seen(camera)
    rig = rig_of(120)
    alone = written(tmp_path / "one.ply", sphere()).hidden(camera, toward, rig, False)
    assert not alone.any()  # a ball hides nothing from itself but what is behind its surface
    two = written(tmp_path / "two.ply", sphere(), sphere(centre=(2.2, 0, 0)))
    hidden = two.hidden(camera, toward, rig, False)
    offset = np.array([2.2, 0, 0]) - points
    along = rig.directions @ offset.T
    miss = np.sqrt(np.maximum((offset**2).sum(1) - along**2, 0))
    before = rig.directions @ points.T > 0.05
    assert hidden[before & (along > 0) & (miss < 0.97)].all() and not hidden[(along < 0) | (miss > 1.03)].any()
    near = LightTable(rig.directions, 1.05 * rig.directions, rig.intensity, rig.solid_angle)
    assert not written(tmp_path / "again.ply", sphere()).hidden(camera, toward, near, True).any()
    samples = Samples(None, *(np.ones((len(rig), len(toward), 3), np.uint16) for _ in range(2)))
    used, view, places = two.applied(samples, camera, toward, rig, None, (3, 9))
    assert places is None and used.cross.shape[1] == len(view) == 6
    np.testing.assert_array_equal(used.parallel[..., 0] == 0, hidden[:, 3:9])


def test_another_objects_mesh_is_refused(camera, tmp_path):
    geometry = written(tmp_path / "far.ply", sphere(centre=(50, 0, 0)))
    with pytest.raises(UserError, match=r"far\.ply: fills 0 % of the mask"):
        geometry.covered(camera, np.ones((SIZE, SIZE), bool))
    write_ply(tmp_path / "points.ply", {c: np.zeros(3, np.float32) for c in "xyz"})
    capture = SimpleNamespace(root=tmp_path)
    assert geometry_file(capture, "") is None
    with pytest.raises(UserError, match="holds no triangles"):
        geometry_file(capture, "points.ply")
    with pytest.raises(UserError, match="no such file"):
        geometry_file(capture, "none.ply")
