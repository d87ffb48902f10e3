"""Splats seen nearly edge-on: what training leaves out of their opacity, and what is written nevertheless."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
import torch

from stages.train.render_view import GRAZING, LEARNT_FROM, SHOWN_FROM, inner_coverage, rasterise_view
from stages.train.splats.gaussians import Splats, normal_quaternions
from stages.train.splats.taken_rows import cosines

SIZE, DISTANCE = 32, 10.0


def plate(normal: tuple[float, float, float]) -> Splats:
    """One small disc at the origin."""
    n = torch.tensor([normal], dtype=torch.float32)
    one = torch.ones(1)
    return Splats(
        torch.zeros(1, 3), n, normal_quaternions(n), torch.full((1, 2), 0.3), 0.9 * one, torch.full((1, 3), 0.5), 0.4 * one,
        1.5 * one,
    )  # fmt: skip


def camera() -> SimpleNamespace:
    """A view along +z from z = -DISTANCE, one unit four pixels wide, through the middle of a pixel."""
    world_to_camera = torch.eye(4)
    world_to_camera[2, 3] = DISTANCE
    lens = torch.tensor([[4 * DISTANCE, 0, SIZE / 2 + 0.5], [0, 4 * DISTANCE, SIZE / 2 + 0.5], [0, 0, 1]])
    return SimpleNamespace(
        world_to_camera=world_to_camera, intrinsics=lens, size=(SIZE, SIZE), pixels=torch.arange(SIZE * SIZE)
    )  # fmt: skip


def seen_at(cosine: float) -> tuple[float, float, float]:
    return (float(np.sqrt(1 - cosine**2)), 0.0, -cosine)


@pytest.mark.parametrize(
    "cosine, learnt, shown",
    [(0.5, 1.0, 1.0), (GRAZING, 1.0, 1.0), (0.075, 0.5, 0.75), (0.04, 0.0, 0.4), (-0.02, 0.0, 0.0), (-0.5, 0.0, 0.0)],
)
def test_a_splat_fades_towards_the_horizon_and_later_in_what_is_written(cosine, learnt, shown):
    splats, view = plate(seen_at(cosine)), camera()
    whole = rasterise_view(plate((0.0, 0.0, -1.0)), view, view.pixels, "cpu").alpha.max()
    for faintest, share in ((LEARNT_FROM, learnt), (SHOWN_FROM, shown)):
        alpha = rasterise_view(splats, view, view.pixels, "cpu", faintest=faintest).alpha
        assert float(alpha.max() / whole) == pytest.approx(share, abs=0.1)


def test_the_inner_side_is_covered_where_the_outer_one_is_not():
    view = camera()
    assert inner_coverage(plate((0.0, 0.0, 1.0)), view, "cpu").max() > 0.8
    assert inner_coverage(plate((0.0, 0.0, -1.0)), view, "cpu").max() == 0


def test_cosines_are_the_same_by_kernel_and_in_torch():
    rng = np.random.default_rng(0)
    n = torch.nn.functional.normalize(torch.as_tensor(rng.normal(size=(50, 3)), dtype=torch.float32), dim=-1)
    one = torch.ones(50)
    splats = Splats(n * 0.7, n, normal_quaternions(n), torch.ones(50, 2), one, torch.ones(50, 3), one, one)
    double = Splats(*(getattr(splats, name).double() for name in Splats.__dataclass_fields__))
    centre = torch.tensor([0.3, -2.0, 4.0])
    assert cosines(splats, centre).numpy() == pytest.approx(cosines(double, centre.double()).numpy(), abs=1e-5)
