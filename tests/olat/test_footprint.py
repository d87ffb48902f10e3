"""Widths of the surface: a pixel's spread of normals is taken out, whatever bands the frame is read in."""

from itertools import pairwise

import numpy as np
import pytest

from stages.olat.maps.footprint import spreads, surface_widths, with_neighbours
from stages.olat.maps.tangents import borne_out
from stages.olat.pixel_fit.result_layout import WIDTH, map_slices
from stages.olat.reading.scanline_bands import Band

AT = map_slices()


def ball(size: int = 48) -> np.ndarray:
    y, x = (np.mgrid[:size, :size] + 0.5) / size * 2.4 - 1.2
    z = np.sqrt(np.clip(1 - x**2 - y**2, 0, None))
    return np.stack([x, y, z], -1) * (z > 0.3)[..., None]


def rows_of(normals: np.ndarray, sigma: tuple[float, float]) -> np.ndarray:
    inside = normals.any(-1)
    rows = np.zeros((inside.sum(), WIDTH))
    n = normals[inside]
    t = np.cross([0.0, 1.0, 0.0], n)
    rows[:, AT["normal"]] = rows[:, AT["specular_normal"]] = n
    rows[:, AT["tangent"]] = t / np.linalg.norm(t, axis=1, keepdims=True)
    rows[:, AT["sigma"]] = sigma
    return rows


def test_the_spread_across_a_cylinder_widens_only_its_own_axis():
    angle = np.linspace(-1, 1, 40)
    normals = np.tile(np.stack([np.sin(angle), 0 * angle, np.cos(angle)], -1), (10, 1, 1))
    per_pixel = angle[1] - angle[0]
    true = np.array([0.3, 0.1])
    rows = rows_of(normals, (0.3, 0.1))  # the larger width lies along x, around the cylinder
    rows[:, AT["sigma"]] = np.sqrt(true**2 + np.array([per_pixel**2 / 6, 0]))  # twice the variance of a uniform spread
    surface_widths(rows, spreads(normals).reshape(-1, 3, 3))
    inner = rows.reshape(10, 40, -1)[:, 1:-1]
    assert np.allclose(inner[..., AT["sigma"]], true, rtol=1e-3)
    assert np.allclose(inner[..., AT["anisotropy"]], 0.5, atol=1e-3)


def test_a_spread_larger_than_the_lobe_leaves_half_its_width():
    normals = ball(12)
    rows = rows_of(normals, (0.05, 0.05))
    inside = normals.any(-1)
    surface_widths(rows, spreads(normals)[inside])
    assert np.all(rows[:, AT["sigma"]] >= 0.0249) and np.all(rows[:, AT["sigma"]] < 0.05)


def test_bands_do_not_change_the_widths():
    normals = ball()
    inside = normals.any(-1)

    def widths(edges: list[int]) -> np.ndarray:
        bands = []
        for top, bottom in pairwise(edges):
            pixels = np.flatnonzero(inside[top:bottom]) + top * inside.shape[1]
            rows = rows_of(normals, (0.3, 0.2))[np.searchsorted(np.flatnonzero(inside), pixels)]
            rows[pixels % 3 == 0, AT["tangent"]] = 0  # some have no tangent, and others lose it
            bands.append((Band(top, bottom, pixels), rows))
        return np.concatenate([rows for _, rows in with_neighbours(bands, inside.shape[1])])

    whole = widths([0, 48])
    assert np.array_equal(whole, widths([0, 16, 32, 48]))
    assert np.array_equal(whole, widths([0, 1, 2, 30, 48]))


def test_an_edge_between_surfaces_is_no_spread():
    normals = np.zeros((4, 6, 3))
    normals[:, :3, 2], normals[:, 3:, 0] = 1, 1
    assert not spreads(normals).any()


@pytest.mark.parametrize("frequency", [0.03, 0.15, 0.25, 0.3])
def test_the_spread_below_a_pixel_is_estimated_from_the_neighbours(frequency):
    """Waves of `frequency` (cycles a pixel) in all directions, 8 x 8 samples a pixel."""
    rng = np.random.default_rng(0)
    fine, count = 8, 40
    y, x = (np.mgrid[: 40 * fine, : 40 * fine] + 0.5) / fine
    slopes = np.zeros((2, *x.shape))
    for angle, phase in rng.uniform(0, 2 * np.pi, (count, 2)):
        wave = np.cos(2 * np.pi * frequency * (np.cos(angle) * x + np.sin(angle) * y) + phase)
        slopes += 0.1 / np.sqrt(count) * np.array([np.cos(angle), np.sin(angle)])[:, None, None] * wave
    normals = np.stack([slopes[0], slopes[1], np.sqrt(1 - slopes[0] ** 2 - slopes[1] ** 2)], -1)
    blocks = normals.reshape(40, fine, 40, fine, 3).swapaxes(1, 2).reshape(40, 40, -1, 3)
    true = blocks[..., :2].var(2).sum(-1)
    mean = blocks.mean(2)
    found = np.trace(spreads(mean / np.linalg.norm(mean, axis=-1, keepdims=True)), axis1=2, axis2=3)
    assert found[2:-2, 2:-2].mean() == pytest.approx(true[2:-2, 2:-2].mean(), rel=0.15)


def test_a_tangent_among_pixels_that_have_none_is_dropped():
    normals = np.zeros((9, 9, 3))
    normals[1:8, 1:8, 2] = 1
    normals[6:8, 6:8] = (1, 0, 0)  # a corner of another surface
    directed = np.zeros((9, 9), bool)
    directed[1, 1:8] = directed[2, 1:8] = True  # an area that has tangents
    directed[5, 2] = True  # one that stands alone
    directed[7, 7] = True  # one of a surface of four pixels
    kept = borne_out(normals, directed)
    assert kept[1:3, 1:8].all() and not kept[5, 2] and not kept[7, 7]
    alone = np.zeros((3, 3, 3))
    alone[1, 1, 2] = 1
    assert borne_out(alone, alone[..., 2] > 0)[1, 1]
