"""Distances along a camera's rays from its normals: neighbours' points differ by what their mean normal allows.

For pixels p, q with rays r and distances t the surface between them lies across its normal: n . (r_q t_q - r_p t_p) = 0, which
is linear in t, holds under perspective and weighs a pixel by how squarely it is seen. An edge across which the surface breaks
off does not hold; its weight falls with its misfit (Geman and McClure).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.linalg import spsolve

from .map_view import MapView

Float = NDArray[np.float64]
BREAK = 0.35  # misfit of an edge, in pixel footprints, at which it begins to count as a break of the surface
SLOPES = 300.0  # weight of an edge's misfit against a pixel's distance: normals are right to 1/20 footprint an edge


@dataclass(frozen=True)
class Pixels:
    """A camera's P pixels with normals: rays and normals [P, 3] (world), edges [E, 2] between neighbours, width of a pixel as
    an angle; `slopes` [E, 2]: n . r of either end, n the mean normal."""

    view: MapView
    rows: NDArray[np.int64]
    columns: NDArray[np.int64]
    rays: Float
    normals: Float
    edges: NDArray[np.int64]
    slopes: Float
    angle: float

    def points(self, distance: Float) -> Float:
        """World points [P, 3] at distances [P]."""
        return self.view.camera.centre + self.rays * distance[:, None]

    def image(self, values: Float) -> Float:
        """Values [P] as an image, 0 elsewhere."""
        out = np.zeros(self.view.mask.shape)
        out[self.rows, self.columns] = values
        return out


def pixels_of(view: MapView) -> Pixels:
    """The pixels of a view that have a normal facing the camera."""
    rays = view.camera.rays()
    facing = view.known & ((view.normal * rays).sum(-1) < 0)
    rows, columns = np.nonzero(facing)
    place = np.full(view.mask.shape, -1)
    place[rows, columns] = np.arange(len(rows))
    pairs = [np.stack([a.ravel(), b.ravel()], -1) for a, b in ((place[:, :-1], place[:, 1:]), (place[:-1], place[1:]))]
    edges = np.concatenate(pairs)
    edges = edges[(edges >= 0).all(1)]
    r, n = rays[rows, columns], view.normal[rows, columns]
    mean = n[edges].sum(1)
    mean /= np.maximum(np.linalg.norm(mean, axis=1, keepdims=True), 1e-6)
    slopes = (mean[:, None] * r[edges]).sum(-1)
    return Pixels(view, rows, columns, r, n, edges, slopes, 1.0 / np.sqrt(view.camera.fx * view.camera.fy))


def misfits(pixels: Pixels, distance: Float) -> Float:
    """How far each edge [E] is from lying across its normal, in pixel footprints."""
    foot = pixels.angle * distance[pixels.edges].mean(1)
    return (pixels.slopes[:, 1] * distance[pixels.edges[:, 1]] - pixels.slopes[:, 0] * distance[pixels.edges[:, 0]]) / foot


def edge_weights(pixels: Pixels, distance: Float, scale: float = BREAK) -> Float:
    """Weights [E] of the edges by their misfits at the distances."""
    return 1.0 / (1.0 + (misfits(pixels, distance) / scale) ** 2) ** 2


def integrated(pixels: Pixels, target: Float, trust: Float, weights: Float) -> Float:
    """Distances [P] that follow the normals over edges of these weights [E], near targets [P] trusted by `trust` [P]."""
    edges, count = pixels.edges, len(target)
    foot = pixels.angle * target
    scale = np.sqrt(weights * SLOPES) / foot[edges].mean(1)
    index = np.arange(len(edges))
    values = np.concatenate([-scale * pixels.slopes[:, 0], scale * pixels.slopes[:, 1]])
    system = sparse.coo_matrix((values, (np.tile(index, 2), edges.T.ravel())), (len(edges), count)).tocsr()
    pull = trust / foot**2
    matrix = (system.T @ system + sparse.diags(pull)).tocsc()
    return spsolve(matrix, pull * target)
