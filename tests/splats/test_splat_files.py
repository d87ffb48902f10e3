"""Files of Gaussians hold what they were given, in the axes and steps that their formats state."""

from __future__ import annotations

import gzip
import json
import struct

import numpy as np
import pytest

from pipeline.splats import harmonics
from pipeline.splats.cloud import SplatCloud
from pipeline.splats.gltf import write_splat_glb
from pipeline.splats.splat_ply import read_splat_ply, write_splat_ply
from pipeline.splats.spz import representable, write_spz

COUNT = 50


@pytest.fixture
def cloud() -> SplatCloud:
    rng = np.random.default_rng(0)
    q = rng.normal(size=(COUNT, 4))
    q /= np.linalg.norm(q, axis=1, keepdims=True) * np.sign(q[:, :1])
    scales = np.concatenate([rng.uniform(-6, -3, (COUNT, 2)), np.full((COUNT, 1), -9.0)], 1)
    return SplatCloud(
        rng.normal(size=(COUNT, 3)), q, scales, rng.normal(2, 1, COUNT), rng.normal(0, 0.2, (COUNT, 16, 3)).clip(-0.9, 0.9)
    )


def rotation() -> np.ndarray:
    from scipy.spatial.transform import Rotation

    return Rotation.from_rotvec([0.4, -1.1, 0.7]).as_matrix()


def test_the_harmonics_are_orthonormal_and_have_the_phase_of_3d_gaussian_splatting():
    nodes, weights = np.polynomial.legendre.leggauss(8)
    angle = 2 * np.pi * np.arange(16) / 16
    z, phi = (a.ravel() for a in np.meshgrid(nodes, angle, indexing="ij"))
    s = np.sqrt(1 - z * z)
    b = harmonics.basis(np.stack([s * np.cos(phi), s * np.sin(phi), z], -1))
    weight = np.repeat(weights, 16) * 2 * np.pi / 16
    assert np.allclose(np.einsum("p,pi,pj->ij", weight, b, b), np.eye(16), atol=1e-12)
    along_x = harmonics.basis(np.array([1.0, 0, 0]))  # the published shader: -C1 x, C2[4] (x x - y y), -C3 x (x x - 3 y y)
    assert np.allclose(along_x[[3, 8, 15]], [-0.4886025119, 0.5462742153, -0.5900435899])
    assert np.allclose(harmonics.basis(np.array([0, 1.0, 0]))[[1, 9]], [-0.4886025119, 0.5900435899])


def test_a_turned_cloud_looks_the_same_from_a_turned_camera(cloud):
    turn, camera = rotation(), np.array([0.5, 3.0, -4.0])
    turned = cloud.turned(turn, 2.0)
    assert np.allclose(turned.colours(2 * turn @ camera), cloud.colours(camera))
    assert np.allclose(np.exp(turned.log_scales), 2 * np.exp(cloud.log_scales))
    with pytest.raises(ValueError, match="reflection"):
        cloud.turned(np.diag([1.0, 1.0, -1.0]))


def test_a_ply_comes_back_and_has_the_published_layout(cloud, tmp_path):
    write_splat_ply(tmp_path / "a.ply", cloud, ["offset 1 2 3"])
    back = read_splat_ply(tmp_path / "a.ply")
    for name, values in vars(cloud).items():
        assert np.allclose(getattr(back, name), values, atol=1e-5), name
    head = (tmp_path / "a.ply").read_bytes().split(b"end_header")[0].decode()
    names = [line.split()[-1] for line in head.splitlines() if line.startswith("property")]
    assert names[:9] == ["x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2"]
    assert names[9:54] == [f"f_rest_{k}" for k in range(45)]
    assert names[54:] == ["opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"]


def unpacked(path) -> dict[str, np.ndarray]:
    """An SPZ of version 3 and degree 3, read by the words of its description: RUB axes, xyzw."""
    data = gzip.decompress(path.read_bytes())
    magic, version, count, degree, fraction, flags, _ = struct.unpack("<IIIBBBB", data[:16])
    assert (magic, version, degree, flags) == (0x5053474E, 3, 3, 0)
    sizes = [9, 1, 3, 3, 4, 45]
    assert len(data) == 16 + count * sum(sizes)
    parts, at = [], 16
    for size in sizes:
        parts.append(np.frombuffer(data, np.uint8, count * size, at).reshape(count, size))
        at += count * size
    low = parts[0].reshape(count, 3, 3).astype(np.int64)
    whole = low[..., 0] | low[..., 1] << 8 | low[..., 2] << 16
    whole = np.where(whole >= 1 << 23, whole - (1 << 24), whole)
    word = parts[4].astype(np.uint32) @ (1 << 8 * np.arange(4, dtype=np.uint32))
    q = np.zeros((count, 4))
    for row, bits in enumerate(word.tolist()):
        largest = bits >> 30
        for k in (i for i in (3, 2, 1, 0) if i != largest):
            size = (bits & 511) / 511 / np.sqrt(2)
            q[row, k] = -size if bits >> 9 & 1 else size
            bits >>= 10
        q[row, largest] = np.sqrt(1 - (q[row] ** 2).sum())
    return {
        "means": whole / 2.0**fraction, "opacity": parts[1][:, 0] / 255, "log_scales": parts[3] / 16 - 10.0,
        "degree0": (parts[2] / 255 - 0.5) / 0.15, "q": q, "rest": (parts[5].reshape(count, 15, 3) - 128.0) / 128,
    }  # fmt: skip


def test_an_spz_holds_the_cloud_within_its_steps_in_its_own_axes(cloud, tmp_path):
    write_spz(tmp_path / "a.spz", cloud)
    found = unpacked(tmp_path / "a.spz")
    half_turn = np.array([1.0, -1, -1])  # a PLY is y down and z forward, SPZ y up and z back
    assert np.abs(found["means"] - cloud.means * half_turn).max() <= 2.0**-12
    assert np.abs(found["opacity"] - 1 / (1 + np.exp(-cloud.opacity))).max() < 0.5 / 255 + 1e-9
    assert np.abs(found["log_scales"] - cloud.log_scales).max() <= 0.5 / 16 + 1e-9
    inside = np.abs(cloud.coefficients[:, 0] * 0.15) < 0.5
    assert np.abs(found["degree0"] - cloud.coefficients[:, 0])[inside].max() < 0.51 / 255 / 0.15
    w, x, y, z = cloud.quaternions.T
    likeness = np.abs((found["q"] * np.stack([x, -y, -z, w], -1)).sum(1))
    assert np.degrees(2 * np.arccos(np.clip(likeness, 0, 1))).max() < 0.35
    expected = harmonics.turned(cloud.coefficients, np.diag(half_turn))[:, 1:]
    off = np.abs(found["rest"] - expected)
    assert off.max() <= 2.6 / 128


def test_spz_tells_small_objects_apart_and_says_what_it_cannot_hold(cloud, tmp_path):
    small = cloud.turned(np.eye(3), 0.01)
    write_spz(tmp_path / "a.spz", small)
    assert np.abs(unpacked(tmp_path / "a.spz")["means"] * [1, -1, -1] - small.means).max() < 1e-5
    assert representable(cloud) == 1 and representable(cloud.turned(np.eye(3), 1e-4)) < 0.5
    far = SplatCloud(cloud.means + 30_000, cloud.quaternions, cloud.log_scales, cloud.opacity, cloud.coefficients)
    write_spz(tmp_path / "b.spz", far)
    assert np.abs(unpacked(tmp_path / "b.spz")["means"] * [1, -1, -1] - far.means).max() < 0.01


def test_a_gltf_holds_the_cloud_and_the_material_beside_it(cloud, tmp_path):
    roughness, albedo = np.linspace(0, 1, COUNT), np.random.default_rng(1).random((COUNT, 3))
    write_splat_glb(tmp_path / "a.glb", cloud, {"roughness": roughness, "albedo": albedo})
    data = (tmp_path / "a.glb").read_bytes()
    size = struct.unpack("<I", data[12:16])[0]
    table = json.loads(data[20 : 20 + size])
    primitive = table["meshes"][0]["primitives"][0]
    assert primitive["mode"] == 0 and primitive["extensions"]["KHR_gaussian_splatting"]["colorSpace"] == "srgb_rec709_display"
    assert table["extensionsUsed"] == ["KHR_gaussian_splatting"]

    def values(name: str) -> np.ndarray:
        accessor = table["accessors"][primitive["attributes"][name]]
        start = 28 + size + table["bufferViews"][accessor["bufferView"]]["byteOffset"]
        width = {"SCALAR": 1, "VEC3": 3, "VEC4": 4}[accessor["type"]]
        return np.frombuffer(data, "<f4", accessor["count"] * width, start).reshape(accessor["count"], width)

    k = "KHR_gaussian_splatting:"
    assert np.allclose(values(k + "ROTATION"), cloud.quaternions[:, [1, 2, 3, 0]], atol=1e-6)
    assert np.allclose(values(k + "SCALE"), np.exp(cloud.log_scales), atol=1e-6)
    assert np.allclose(values(k + "OPACITY")[:, 0], 1 / (1 + np.exp(-cloud.opacity)), atol=1e-6)
    assert np.allclose(values(k + "SH_DEGREE_3_COEF_6"), cloud.coefficients[:, 15], atol=1e-6)
    assert np.allclose(values(k + "SH_DEGREE_1_COEF_0"), cloud.coefficients[:, 1], atol=1e-6)
    assert np.allclose(values("_ROUGHNESS")[:, 0], roughness, atol=1e-6) and np.allclose(values("_ALBEDO"), albedo, atol=1e-6)
