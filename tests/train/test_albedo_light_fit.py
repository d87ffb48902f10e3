"""Light against albedo by least squares: means, not medians, are fitted; what views disagree on is left; the image stays."""

from __future__ import annotations

from functools import lru_cache
from types import SimpleNamespace

import pytest
import torch

from pipeline.shading import EnvironmentCube, Prefilter, shade
from stages.train.albedo_light_fit import MOST, ScaleFit, parts, solved
from stages.train.log_environment import Environment

POINTS = 2000


@lru_cache
def seen(seed: int, light: float = 1.0, noise: float = 0.0) -> tuple[SimpleNamespace, SimpleNamespace]:
    """A view (as training keeps it) of a patch under a sky `light` times as bright, and its rendering, whose mirrored light is
    blurred: measured in few bright places, by `noise` of its mean."""
    g = torch.Generator().manual_seed(seed)
    normal = torch.nn.functional.normalize(0.5 * torch.rand(POINTS, 3, generator=g) + torch.tensor([0, 0, 0.5]), dim=-1)
    view = torch.tensor([0, 0, 1.0]).expand(POINTS, 3).contiguous()
    x, y = torch.eye(3)[:2, None].expand(2, POINTS, 3).unbind(0)
    albedo = 0.1 + 0.3 * torch.rand(POINTS, 3, generator=g)
    rest = torch.full((POINTS,), 0.4), torch.full((POINTS,), 1.5), x.contiguous(), y.contiguous()
    sky = Prefilter(8, "beckmann").apply(EnvironmentCube(8, 0.5).radiance().detach())
    shaded, alone = (shade(normal, view, k * albedo, *rest, sky) for k in (1, 0))
    buffer = SimpleNamespace(normal=normal, ior=rest[1], alpha=torch.ones(POINTS))
    rendered = SimpleNamespace(stokes=shaded.stokes, shaded=shaded, gbuffer=buffer, mirrored=alone.stokes)
    frame = SimpleNamespace(frame_x=rest[2], frame_y=rest[3], view_direction=view)
    mirrored, body = parts(frame, rendered)
    bright = torch.where(torch.rand(POINTS, generator=g) < 0.1, 1 + 9 * noise, 1 - noise)[:, None, None]
    weights = {"colour_weight": torch.ones(POINTS), "inside": torch.ones(POINTS, dtype=torch.bool)}
    return SimpleNamespace(**vars(frame), **weights, target=light * bright * mirrored + body), rendered


def scene_of(albedo: float = 0.3) -> SimpleNamespace:
    model = {"albedo": torch.logit(torch.full((50, 3), albedo)).requires_grad_(True)}
    return SimpleNamespace(environment=Environment(8, 0.5), model=model, bank=None, occlusion={}, splat_occlusion=None)


def fit(views: int = 8, **how: float) -> ScaleFit:
    out = ScaleFit()
    for k in range(views):
        out.add(*seen(k, **how), "stokes", scene_of())
    return out


def test_mirrored_light_and_the_body_s_are_told_apart_with_their_polarisation():
    """What black paint would leave is mirrored."""
    view, rendered = seen(0)
    mirrored, body = parts(view, rendered)
    assert torch.allclose(mirrored, rendered.mirrored, atol=1e-5)
    assert torch.allclose(mirrored + body, rendered.stokes)
    assert float(body[:, 1:].abs().max()) > 1e-3


def test_skewed_highlights_that_a_model_blurs_do_not_darken_the_light():
    light, diffuse = fit(light=1.08, noise=0.5).scales()
    assert torch.allclose(light, torch.full((3,), 1.08, dtype=torch.float64), atol=0.03)
    assert torch.allclose(diffuse, torch.ones(3, dtype=torch.float64), atol=0.02)


def test_light_and_albedo_take_the_scale_so_that_the_diffuse_image_stays():
    scene = scene_of()
    before = scene.environment.radiance().mean() * torch.sigmoid(scene.model["albedo"]).mean()
    before = float(before.detach())
    light, _ = fit(light=1.15).apply(scene)
    assert torch.allclose(scene.environment.radiance().detach(), 0.5 * light.float(), rtol=1e-3)
    after = scene.environment.radiance().mean() * torch.sigmoid(scene.model["albedo"]).mean()
    assert float(after.detach()) / before == pytest.approx(1, abs=1e-3)
    assert float(light.mean()) == pytest.approx(1.15, abs=1e-3)


def test_what_the_views_disagree_on_or_too_few_have_seen_changes_nothing():
    fitted = fit(8)
    fitted.products = fitted.products * (1 + 0.3 * torch.randn(8, 1, 1, generator=torch.Generator().manual_seed(3)))
    light, _ = fitted.scales()
    assert float((light - 1).abs().max()) < 0.05
    assert torch.equal(fit(3, light=1.5).scales()[0], torch.ones(3, dtype=torch.float64))


def test_what_blur_cannot_explain_is_bounded():
    assert fit(light=3.0).scales()[0].tolist() == [MOST] * 3


def test_an_object_that_mirrors_or_scatters_nothing_is_left_alone():
    """A singular system has no answer."""
    fitted = fit(6, light=1.5)
    fitted.squares[..., 1, :] = fitted.squares[..., :, 1] = 0
    assert torch.isnan(solved(fitted.squares.sum(0), fitted.products.sum(0))).all()
    assert torch.equal(torch.stack(fitted.scales()), torch.ones(2, 3, dtype=torch.float64))


def test_a_resumed_fit_goes_on_as_it_would_have():
    straight, resumed = fit(6, light=1.1), ScaleFit()
    resumed.load(fit(3, light=1.1).state())
    for k in range(3, 6):
        resumed.add(*seen(k, light=1.1), "stokes", scene_of())
    assert torch.equal(resumed.squares, straight.squares) and torch.equal(resumed.products, straight.products)
