"""OBJ meshes as a true surface: corners in every notation, and files that are none."""

import numpy as np
import pytest

from pipeline.errors import UserError
from pipeline.formats.ground_truth import Truth
from pipeline.formats.obj import read_obj

SQUARE = "# made\nv 0 0 0\nv 1 0 0 1\nv 1 1 0\nv 0 1 0\nvn 0 0 1\n"


@pytest.mark.parametrize("face", ["f 1 2 3 4", "f 1/1 2/2 3/3 4/4", "f 1//1 2//1 3//1 4//1", "f -4 -3 -2 -1"])
def test_a_face_of_four_corners_is_two_triangles_in_every_notation(tmp_path, face):
    (tmp_path / "a.obj").write_text(SQUARE + face + "\n")
    vertices, triangles = read_obj(tmp_path / "a.obj")
    assert np.array_equal(vertices[2], [1, 1, 0]) and triangles.tolist() == [[0, 1, 2], [0, 2, 3]]


@pytest.mark.parametrize("face", ["f 1 2 5", "f 1 x 2", "f 1 2 0", "v a b c"])
def test_what_is_no_mesh_is_named(tmp_path, face):
    (tmp_path / "a.obj").write_text(SQUARE + face + "\n")
    with pytest.raises(UserError, match=r"a\.obj"):
        read_obj(tmp_path / "a.obj")
    with pytest.raises(UserError, match="cannot be read"):
        read_obj(tmp_path / "b.obj")


def test_the_surface_of_a_published_scene_lies_beside_its_pictures(tmp_path):
    (tmp_path / "snail.obj").write_text(SQUARE)
    published = Truth(tmp_path, (), "smvp3d")
    assert published.mesh == tmp_path / "snail.obj" and published.mesh in published.files()
    assert Truth(tmp_path, (), "stokes_transforms").mesh == tmp_path / "gt" / "mesh.ply"
    (tmp_path / "gt").mkdir()
    (tmp_path / "gt" / "mesh.ply").write_text("")
    assert published.mesh.suffix == ".ply"
