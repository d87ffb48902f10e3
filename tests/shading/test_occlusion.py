"""Self-occlusion: closed forms of simple shapes, energy, gradients."""

import numpy as np
import pytest
import torch

from pipeline.geometry.occluder import Occluder, simplified, tangent_frames
from pipeline.shading import latlong
from pipeline.shading.occluded import blocked_share
from pipeline.shading.transfer import Transfer

from .conftest import part_of_ball


def test_a_convex_object_occludes_nothing(ball):
    assert blocked_share(ball) < 1e-3
    transfer = Transfer(ball, np.full((len(ball.vertices), 3), 0.5))
    light = transfer.light(torch.rand(6, 16, 16, 3))
    assert (light.shadow - 1).abs().max() < 1e-3 and light.bounced.abs().max() < 1e-3


@pytest.mark.slow
def test_a_half_sphere_blocks_half_the_light_of_every_point_inside_it(bowl):
    # Form factor from anywhere inside a sphere to a part of it is the part's area over the whole: one half.
    assert blocked_share(bowl, 2000) == pytest.approx(0.5, abs=0.02)
    transfer = Transfer(bowl, np.full((len(bowl.vertices), 3), 0.8), resolution=16)
    light = transfer.light(torch.ones(6, 32, 32, 3))
    inner = torch.as_tensor(bowl.vertices[:, 1] < -0.1)  # the rim's rays graze its own edge
    assert light.shadow[inner].mean() == pytest.approx(0.5, abs=0.03)
    # Uniform, so one bounce adds scale * albedo * direct * (blocked share); two bounces the next term of that series.
    one = transfer.light(torch.ones(6, 32, 32, 3), bounces=1).bounced[inner].mean()
    assert light.bounced[inner].mean() > one
    assert (light.shadow * np.pi * 0.9082 + light.bounced)[inner].max() < np.pi * 0.9082  # never more than the sky


@pytest.mark.slow
def test_transfer_is_differentiable_in_the_environment(bowl):
    radiance = torch.rand(6, 16, 16, 3, generator=torch.Generator().manual_seed(0)).requires_grad_()
    transfer = Transfer(bowl, np.full((len(bowl.vertices), 3), 0.5))
    light = transfer.light(radiance)
    points, normals = bowl.vertices[100:110], bowl.normals[100:110]
    attached = transfer.attach(points, normals, normals, np.full(10, 0.3))
    occlusion = transfer.occlusion(attached, light)
    total = occlusion.shadow.sum() + occlusion.bounced.sum() + occlusion.seen.sum()
    gradient = torch.autograd.grad(total, radiance)[0]
    step = torch.randn(radiance.shape, generator=torch.Generator().manual_seed(1)) * 1e-2

    def value(x: torch.Tensor) -> float:
        o = transfer.occlusion(attached, transfer.light(x))
        return float(o.shadow.double().sum() + o.bounced.double().sum() + o.seen.double().sum())

    with torch.no_grad():
        difference = (value(radiance + step) - value(radiance - step)) / 2
    assert difference == pytest.approx(float((gradient * step).sum()), rel=0.03)


def test_mirror_rays_leave_the_ball_and_meet_the_bowl(ball, bowl):
    for mesh, free in ((ball, 1.0), (bowl, 0.0)):
        transfer = Transfer(mesh, np.full((len(mesh.vertices), 3), 0.5))
        chosen = np.flatnonzero(np.abs(mesh.vertices[:, 1] + 0.3) < 0.1)[:20]
        normals = mesh.normals[chosen]
        # Grazing views of the bowl mirror into its other side.
        tangent = tangent_frames(normals)[:, 0]
        view = 0.3 * normals + tangent * np.sign(-tangent[:, 1:2]) * -0.95
        view /= np.linalg.norm(view, axis=1, keepdims=True)
        attached = transfer.attach(mesh.vertices[chosen], normals, view, np.full(len(chosen), 0.1))
        down = (2 * (normals * view).sum(1, keepdims=True) * normals - view)[:, 1] < 0
        assert attached.unblocked[torch.as_tensor(down)].mean() == pytest.approx(free, abs=0.05)
        held = torch.sparse.sum(attached.mirrored.to_sparse_coo(), 1).to_dense()
        torch.testing.assert_close(held, 1 - attached.unblocked, rtol=1e-4, atol=1e-5)


def test_a_black_environment_casts_no_shadow_and_no_nan(bowl):
    transfer = Transfer(bowl, np.zeros((len(bowl.vertices), 3)))
    light = transfer.light(torch.zeros(6, 16, 16, 3))
    assert all(torch.isfinite(x).all() for x in (light.shadow, light.bounced, light.leaving))


def test_an_environment_coarser_than_the_transfer_is_refused(ball):
    with pytest.raises(ValueError, match="4"):
        Transfer(ball, np.ones((len(ball.vertices), 3))).light(torch.ones(6, 4, 4, 3))


def test_simplified_mesh_keeps_its_shadows():
    v, f = part_of_ball(40, np.pi / 2)
    v2, f2 = simplified(v * [1, -1, 1], f, 1000)
    assert len(f2) <= 1000
    coarse = Occluder(v2, f2[:, ::-1])
    facing_in = (coarse.normals * coarse.vertices).sum(1).mean() < 0
    assert blocked_share(Occluder(v2, f2 if not facing_in else f2[:, ::-1])) == pytest.approx(0.5, abs=0.05)


def test_tangent_frames_are_right_handed_everywhere():
    n = np.concatenate((np.eye(3), -np.eye(3), np.random.default_rng(0).normal(size=(50, 3))))
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    f = tangent_frames(n)
    np.testing.assert_allclose(f @ f.transpose(0, 2, 1), np.broadcast_to(np.eye(3), f.shape), atol=1e-12)
    np.testing.assert_allclose(np.linalg.det(f), 1)


def test_environment_suns_reach_the_transfer_level():
    image = np.zeros((64, 128, 3))
    image[20, 40] = 1e4
    texels = torch.as_tensor(latlong.to_cube(image, 32), dtype=torch.float32)
    v, f = part_of_ball()
    transfer = Transfer(Occluder(v, f, v), np.ones((len(v), 3)))
    assert torch.isfinite(transfer.light(texels).leaving).all() and transfer.light(texels).leaving.max() > 0
