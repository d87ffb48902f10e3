"""The rays that training casts go where their definitions say."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from stages.train.splats.ray_kernels import lobe_directions
from stages.train.splats.splat_occlusion import cosine_rays


def units(count: int, seed: int) -> np.ndarray:
    v = np.random.default_rng(seed).normal(size=(count, 3)).astype(np.float32)
    v[:6] = [[1, 0, 0], [0, 1, 0], [0, 0, 1], [-1, 0, 0], [0, -1, 0], [0, 0, -1]]
    return v / np.linalg.norm(v, axis=1, keepdims=True)


def test_cosine_rays_rise_alike_about_every_normal_and_turn_with_their_angle():
    normals, turn = units(50, 0), np.linspace(-3, 3, 50)
    rays = cosine_rays(24, normals, turn)
    rise = np.einsum("pkj,pj->pk", rays, normals)
    np.testing.assert_allclose(rise, np.broadcast_to(np.sqrt(1 - (np.arange(24) + 0.5) / 24), (50, 24)), atol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(rays, axis=-1), 1, atol=1e-6)
    straight = cosine_rays(24, normals, np.zeros(50))
    for p in range(50):
        expected = Rotation.from_rotvec(turn[p] * normals[p]).apply(straight[p])
        np.testing.assert_allclose(rays[p], expected, atol=2e-6)


@pytest.mark.parametrize("roughness", [1e-3, 0.1, 0.5, 1.0])
def test_lobe_rays_mirror_the_view_at_half_vectors_of_the_beckmann_share_asked_for(roughness):
    normals, view = units(40, 1), units(40, 2)
    view = np.where(np.einsum("pk,pk->p", normals, view)[:, None] < 0, -view, view)
    rng = np.random.default_rng(3)
    u, angle = (rng.random((40, 9)).astype(np.float32) * s for s in (0.999, 6.28))
    u[:, 0] = 0
    out, rise = np.empty((40, 9, 3), np.float32), np.empty((40, 9), np.float32)
    lobe_directions(
        normals, view, np.full(40, roughness, np.float32), u.astype(np.float32), angle.astype(np.float32), out, rise
    )
    np.testing.assert_allclose(np.linalg.norm(out, axis=-1), 1, atol=1e-6)
    np.testing.assert_allclose(rise, np.einsum("pkj,pj->pk", out, normals), atol=2e-6)
    half = out.astype(float) + view[:, None]
    length = np.linalg.norm(half, axis=-1)
    steep = length > 0.2  # below, the half vector is lost in rounding
    cosine = np.abs(np.einsum("pkj,pj->pk", half, normals)) / np.maximum(length, 1e-9)
    # Beckmann: the share of half vectors within an angle is 1 - exp(-tan^2 / alpha^2)
    expected = 1 / np.sqrt(1 - roughness**4 * np.log1p(-u.astype(float)))
    np.testing.assert_allclose(cosine[steep], expected[steep], atol=2e-5)
