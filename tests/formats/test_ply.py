"""PLY files: what other programs write is read, damage is reported in one line, and what is written stays as it is."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest

from pipeline.errors import UserError
from pipeline.formats.ply import Ply, write_ply

CORNERS = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1.5]])
HEAD = "ply\nformat {} 1.0\ncomment by hand\n"


def pyramid(order: str, kinds: tuple[str, str, str] = ("float", "uchar", "int")) -> bytes:
    """A square and four triangles, with properties in an unusual order, in text ("") or binary ("<", ">")."""
    real, length, index = kinds
    codes = {"float": "f", "double": "d", "uchar": "B", "int": "i", "uint16": "H", "uint": "I", "ushort": "H"}
    head = HEAD.format({"": "ascii", "<": "binary_little_endian", ">": "binary_big_endian"}[order])
    head += f"obj_info none\nelement vertex 5\nproperty uchar red\nproperty {real} z\nproperty {real} y\nproperty {real} x\n"
    head += f"element face 5\nproperty uchar flags\nproperty list {length} {index} vertex_index\nend_header\n"
    faces = [(0, 3, 2, 1), (0, 1, 4), (1, 2, 4), (2, 3, 4), (3, 0, 4)]
    if not order:
        rows = [f"7 {z} {y} {x}" for x, y, z in CORNERS] + [f"1 {len(f)} {' '.join(map(str, f))}" for f in faces]
        return (head + "\n".join(rows) + "\n").encode()
    body = b"".join(struct.pack(order + "B3" + codes[real], 7, *point[::-1]) for point in CORNERS)
    body += b"".join(struct.pack(f"{order}B{codes[length]}{len(f)}{codes[index]}", 1, len(f), *f) for f in faces)
    return head.encode() + body


def read(path: Path, data: bytes) -> Ply:
    path.write_bytes(data)
    return Ply(path)


@pytest.mark.parametrize("kinds", [("float", "uchar", "int"), ("double", "uint16", "uint")])
@pytest.mark.parametrize("order", ["", "<", ">"])
def test_a_mesh_of_any_byte_order_and_property_order_is_read(tmp_path: Path, order: str, kinds: tuple[str, str, str]) -> None:
    ply = read(tmp_path / "a.ply", pyramid(order, kinds))
    assert np.array_equal(ply.vertices(), CORNERS)
    assert ply.triangles().tolist() == [[0, 3, 2], [0, 2, 1], [0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]]
    assert np.array_equal(ply.vertices(("red",))[:, 0], np.full(5, 7.0))


@pytest.mark.parametrize("ending", [b"\r\n", b"\r"])
def test_line_endings_of_other_systems_are_read(tmp_path: Path, ending: bytes) -> None:
    text = pyramid("").replace(b"\n", ending)
    assert np.array_equal(read(tmp_path / "a.ply", text).vertices(), CORNERS)
    head, _, body = pyramid("<").partition(b"end_header\n")
    binary = head.replace(b"\n", ending) + b"end_header" + ending + body
    assert np.array_equal(read(tmp_path / "b.ply", binary).vertices(), CORNERS)


def test_a_concave_quadrilateral_is_cut_inside_itself(tmp_path: Path) -> None:
    dart = "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n"
    dart += "element face 1\nproperty list uchar int vertex_indices\nend_header\n"
    dart += "-1 -1 0\n0 1 0\n1 -1 0\n0 -0.5 0\n4 0 1 2 3\n"
    ply = read(tmp_path / "dart.ply", dart.encode())
    a, b, c = (ply.vertices()[ply.triangles()[:, k]] for k in range(3))
    turn = np.cross(b - a, c - a)[:, 2] / 2
    assert len(turn) == 2 and (turn < 0).all() and turn.sum() == pytest.approx(-1.5)


@pytest.mark.parametrize(
    ("data", "fault"),
    [
        (b"", "empty"),
        (b"solid cube\n", "not a PLY"),
        (b"ply\nformat ascii 1.0\nelement vertex 1\n", "no end"),
        (b"ply\nelement vertex 0\nend_header\n", "no format"),
        (pyramid("<")[:-3], "truncated: 4 of 5 face rows"),
        (pyramid(">")[:-40], "truncated"),
        (pyramid("")[:-8], "truncated: 4 of 5 face rows"),
        (pyramid("<").replace(b"float z", b"quad z"), "'property quad z'"),
        (pyramid("<").replace(b"element vertex 5", b"element vertex -5"), "'element vertex -5'"),
        (pyramid("<").replace(b"float y", b"float z"), "two properties of one name"),
        (pyramid("").replace(b"1.5", b"1,5"), "'1,5' stands where a number should"),
        (pyramid("").replace(b"3 3 0 4", b"3 3 0 9"), "a face names vertex 9 of 5"),
        (pyramid("").replace(b"vertex_index", b"edges"), "no list vertex_indices"),
        (b"ply\nformat ascii 1.0\nelement tristrips 1\nproperty list int int vertex_indices\nend_header\n3 0 1 2\n", "strips"),
        (pyramid("").replace(b"float x", b"float u"), "no x (they have red, z, y, u)"),
        (pyramid("").replace(b"element vertex", b"element point"), "no element vertex"),
    ],
)
def test_damage_is_one_line_that_names_file_and_fault(tmp_path: Path, data: bytes, fault: str) -> None:
    with pytest.raises(UserError) as caught:
        ply = read(tmp_path / "bad.ply", data)
        ply.triangles()
        ply.vertices()
    line = str(caught.value)
    assert fault in line and "bad.ply" in line and "\n" not in line and ";" in line


def test_a_huge_count_in_a_damaged_header_is_reported_at_once(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="truncated"):
        read(tmp_path / "a.ply", pyramid("<").replace(b"element vertex 5", b"element vertex 99999999999"))


@pytest.mark.parametrize(
    ("head", "body"),
    [
        (b"element vertex 2\nproperty list uint float x\nproperty float y\n", b"\xff\xff\xff\x7f" * 8),
        (b"element vertex " + b"9" * 5000 + b"\nproperty float x\n", b""),
        (b"element nothing 999999999999999999\nelement vertex 1\nproperty float x\n", b""),
    ],
    ids=["lists", "digits", "rows without anything"],
)
def test_absurd_headers_are_reported_without_taking_memory(tmp_path: Path, head: bytes, body: bytes) -> None:
    (tmp_path / "a.ply").write_bytes(b"ply\nformat binary_little_endian 1.0\n" + head + b"end_header\n" + body)
    with pytest.raises(UserError, match=r"a\.ply: .*(truncated|does not know)"):
        Ply(tmp_path / "a.ply")


def test_a_word_of_many_characters_among_numbers_is_no_number(tmp_path: Path) -> None:
    head = b"ply\nformat ascii 1.0\nelement vertex 100000\nproperty float x\nend_header\n"
    (tmp_path / "a.ply").write_bytes(head + b"1 " * 99_999 + b"1" * 10**6)
    with pytest.raises(UserError, match=r"a word of 1000000 characters"):
        Ply(tmp_path / "a.ply")


def test_a_file_that_is_not_there_is_reported(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="no such file"):
        Ply(tmp_path / "none.ply")


def test_what_is_written_are_these_bytes(tmp_path: Path) -> None:
    columns = {"x": np.array([0.5, 1 / 3]), "red": np.array([1, 255], np.uint8)}
    write_ply(tmp_path / "a.ply", columns, np.array([[0, 1, 1]]))
    head = "ply\nformat binary_little_endian 1.0\nelement vertex 2\nproperty float x\nproperty uchar red\n"
    head += "element face 1\nproperty list uchar int vertex_indices\nend_header\n"
    body = struct.pack("<fBfB", 0.5, 1, 1 / 3, 255) + struct.pack("<B3i", 3, 0, 1, 1)
    assert (tmp_path / "a.ply").read_bytes() == head.encode() + body


@pytest.mark.parametrize("text", [False, True])
def test_open3d_reads_what_is_written_and_so_do_we(tmp_path: Path, text: bool) -> None:
    import open3d as o3d

    rng = np.random.default_rng(0)
    points, faces = rng.normal(size=(40, 3)), rng.integers(0, 40, (70, 3))
    write_ply(tmp_path / "a.ply", dict(zip("xyz", points.T)), faces, text=text)
    theirs, ours = o3d.io.read_triangle_mesh(str(tmp_path / "a.ply")), Ply(tmp_path / "a.ply")
    assert np.array_equal(np.asarray(theirs.vertices), ours.vertices())
    assert np.array_equal(np.asarray(theirs.triangles), ours.triangles())
    assert np.abs(ours.vertices() - points).max() < (1e-5 if text else 1e-6)


def test_an_empty_cloud_survives(tmp_path: Path) -> None:
    write_ply(tmp_path / "a.ply", dict(zip("xyz", np.zeros((3, 0)))))
    assert Ply(tmp_path / "a.ply").vertices().shape == (0, 3)
    assert Ply(tmp_path / "a.ply").triangles().shape == (0, 3)
