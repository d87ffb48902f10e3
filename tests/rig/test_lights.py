"""Light tables, solid angles and the light that a map throws on a rig."""

import numpy as np
import pytest

from pipeline.errors import UserError
from pipeline.rig.latlong_lights import as_lights, irradiance_per_light, texels
from pipeline.rig.lsx3_and_csv_light_tables import LSX3_POSITIONS, LSX3_SPIRAL, read_lights_csv, read_lsx3
from pipeline.rig.solid_angles import fibonacci_sphere, solid_angles


def write_lsx3(root, positions, spiral):
    (root / LSX3_POSITIONS).write_text("\n".join(" ".join(map(str, row)) for row in positions))
    (root / LSX3_SPIRAL).write_text("\n".join(map(str, spiral)))


def test_lsx3_light_k_is_the_kth_spiral_row_turned_about_y(tmp_path):
    write_lsx3(tmp_path, [[1, 2, 3], [0, 5, 0], [4, 0, 0]], [3, 1, 2])
    rig = read_lsx3(tmp_path)
    assert np.array_equal(rig.positions, [[-4, 0, 0], [-1, 2, -3], [0, 5, 0]])
    assert np.allclose(np.linalg.norm(rig.directions, axis=1), 1)


@pytest.mark.parametrize(
    ("spiral", "fault"), [([1, 2], "2 entries for the 3 rows"), ([1, 2, 4], "names row 4"), ([1, 1, 2], "names row 1 twice")]
)
def test_bad_spirals_are_refused_by_name(tmp_path, spiral, fault):
    write_lsx3(tmp_path, [[1, 2, 3], [0, 5, 0], [4, 0, 0]], spiral)
    with pytest.raises(UserError, match=fault):
        read_lsx3(tmp_path)


def test_lights_csv_is_ordered_by_index_and_keeps_intensity(tmp_path):
    path = tmp_path / "lights.csv"
    path.write_text("index,x,y,z,intensity\n1,0,2,0,0.5\n0,3,0,0,1.5\n")
    rig = read_lights_csv(path)
    assert np.array_equal(rig.directions, [[1, 0, 0], [0, 1, 0]])
    assert np.array_equal(rig.intensity, [1.5, 0.5])


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        ("", "no column"),
        ("index,x,y\n0,1,2\n", "no column z"),
        ("index,x,y,z\n", "lists no light"),
        ("index,x,y,z\n0,1,2\n", "line 2 has 3 cells"),
        ("index,x,y,z\n0,1,2,up\n", "line 2: z = 'up'"),
        ("index,x,y,z\n0,1,2,3\n0,3,2,1\n", "lists index 0 twice"),
        ("index,x,y,z\n0,0,0,0\n", "has no direction"),
        ("index,x,y,z,intensity\n0,1,0,0,-1\n", "intensity"),
        ("index,x,y,z\n0,nan,0,0\n", "has no direction"),
    ],
)
def test_bad_light_tables_are_refused_with_the_line(tmp_path, text, fault):
    path = tmp_path / "lights.csv"
    path.write_text(text)
    with pytest.raises(UserError, match=fault):
        read_lights_csv(path)


def test_solid_angles_of_a_whole_rig_fill_the_sphere():
    assert np.isclose(solid_angles(fibonacci_sphere(346)).sum(), 4 * np.pi)


def test_cells_at_a_hole_are_capped():
    lights = fibonacci_sphere(346)
    lights = lights[lights[:, 1] > -0.85]
    whole, capped = solid_angles(lights, cap=False), solid_angles(lights)
    assert whole.max() > 2 * np.median(whole)
    assert capped.max() < 1.7 * np.median(whole)
    assert np.all(capped <= whole * 1.02)


def test_few_coplanar_or_doubled_lights_still_have_solid_angles():
    few = np.array([[1.0, 0, 0], [0, 1, 0]])
    assert np.allclose(solid_angles(few), 2 * np.pi, rtol=0.01)
    ring = np.stack([np.cos(np.arange(6)), np.sin(np.arange(6)), np.zeros(6)], -1)
    assert np.isclose(solid_angles(ring, cap=False).sum(), 4 * np.pi, rtol=1e-6)
    doubled = np.concatenate([fibonacci_sphere(50), fibonacci_sphere(50)[:1]])
    areas = solid_angles(doubled)
    assert np.isclose(areas[0], areas[-1]) and np.isclose(areas.sum(), 4 * np.pi, rtol=0.01)


def test_a_constant_map_gives_every_light_its_cell():
    lights = fibonacci_sphere(100)
    light = irradiance_per_light(np.ones((64, 128, 3)), lights)
    assert np.isclose(light[:, 0].sum(), 4 * np.pi)
    assert np.allclose(light[:, 1], solid_angles(lights), rtol=0.15)


@pytest.mark.parametrize("up", ["y", "z"])
def test_a_sun_lands_on_the_light_that_faces_it(up):
    lights = fibonacci_sphere(200)
    sky = np.zeros((64, 128, 3))
    sky[20, 100] = 50.0
    sun = texels(64, 128)[0][20, 100]
    world = sun if up == "y" else np.array([sun[0], -sun[2], sun[1]])  # z up: (x, y, z) of the world is (x, z, -y) of the map
    light = irradiance_per_light(sky, lights, up)
    assert np.argmax(light[:, 0]) == np.argmax(lights @ world)
    directions, power, _ = as_lights(sky, 500, up)
    assert np.allclose(directions[np.argmax(power[:, 0])], world, atol=1e-6)
