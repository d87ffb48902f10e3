"""The visual hull: right size, forgiving of cropped views and bad masks, clear about impossible ones."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pipeline.errors import UserError
from pipeline.geometry.silhouette_hull import Silhouette, occupancy, signed_distance
from stages.train.initialise.hull import visual_hull
from stages.train.initialise.sampling import mesh_area, sample_evenly

from .conftest import AXES


def silhouettes(sources):
    return [Silhouette(s.camera, s.mask) for s in sources]


def implicit(points):
    return np.sqrt(((points / AXES) ** 2).sum(-1))


def test_hull_is_the_object_within_two_percent(make_sources):
    mesh, centre, half = visual_hull(silhouettes(make_sources(64, 24)), 64)
    assert np.percentile(np.abs(implicit(mesh.vertices) - 1), 90) < 0.03
    assert np.abs(centre).max() < 0.03 and abs(half - 1) < 0.04
    outward = (mesh.normals * mesh.vertices / AXES**2).sum(-1)
    assert (outward > 0).mean() > 0.99


@pytest.mark.slow
def test_cropped_views_do_not_carve_the_object(make_sources):
    sources = make_sources(64, 24)
    cut = []
    for k, s in enumerate(sources):
        if k % 3 == 0:
            camera = replace(s.camera, width=40, cx=s.camera.cx)
            s = replace(s, camera=camera, mask=s.mask[:, :40])
        cut.append(s)
    mesh, _, half = visual_hull(silhouettes(cut), 64)
    assert abs(half - 1) < 0.06
    assert np.percentile(np.abs(implicit(mesh.vertices) - 1), 90) < 0.06


@pytest.mark.slow
def test_outvoting_forgives_one_bad_mask(make_sources):
    views = silhouettes(make_sources(48, 24))
    bad = views[5].mask.copy()
    bad[:, :24] = 0
    views[5] = Silhouette(views[5].camera, bad)
    carved, _, _ = visual_hull(views, 48)
    kept, _, _ = visual_hull(views, 48, outvoted=1)
    assert mesh_area(kept) > 1.15 * mesh_area(carved)
    assert np.percentile(np.abs(implicit(kept.vertices) - 1), 90) < 0.06


def test_masks_without_a_common_object_are_refused(make_sources):
    views = silhouettes(make_sources(32, 12))
    views = [Silhouette(v.camera, np.roll(v.mask, 12 if k % 2 else -12, 1) * (v.mask == 0)) for k, v in enumerate(views)]
    with pytest.raises(UserError):
        visual_hull(views, 32)


@pytest.mark.slow
def test_samples_are_even_and_as_many_as_asked(make_sources):
    mesh, _, _ = visual_hull(silhouettes(make_sources(48, 24)), 48)
    samples = sample_evenly(mesh, 800, np.random.default_rng(0))
    assert abs(len(samples.points) / 800 - 1) < 0.1
    assert samples.spacing.std() < 0.2 * samples.spacing.mean()
    again = sample_evenly(mesh, 800, np.random.default_rng(0))
    assert np.array_equal(samples.points, again.points)


def test_one_pass_over_the_points_tells_what_every_picture_says(make_sources):
    """The kernel is the path that can overrule a picture, where each picture comes twice and one of a pair is overruled."""
    sources = make_sources(32, 9)
    silhouettes = [Silhouette(s.camera, s.mask) for s in sources]
    distances = [signed_distance(s.mask) for s in sources]
    points = np.random.default_rng(4).uniform(-3, 3, (3000, 3))  # some before no camera, some outside pictures
    found = occupancy(silhouettes, distances, points)
    wanted = occupancy(2 * silhouettes, 2 * distances, points, outvoted=1)
    assert (found > 0).any() and np.allclose(found, wanted, atol=1e-5)
