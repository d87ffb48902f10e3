"""The parts of an environment that throw shadows with edges: its brightest texels, as a few leaves of its tree of light."""

from __future__ import annotations

import heapq
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .light_tree import LightTree

CONCENTRATION = 4.0
"""How many times an even environment's share of light a texel holds, to count as bright: a clear sky's half holds two."""
MOST_TEXELS = 64  # at least two leaves each
MOST_LEAVES = 128
"""A half-shadow of an even lamp in as many steps is as fine as 7 bits."""
NARROW = np.radians(0.5) ** 2
"""Variance from which on a leaf is cut no more: about that of a texel of a cube of 64."""


@dataclass(frozen=True)
class BrightParts:
    """L leaves that stand for the K' bright of the K texels of a coarser cube, all of the light in them.

    texels [K'] of that cube, ascending; owner [L] in 0..K'-1; direction [L, 3], solid_angle [L] (sr), variance [L] (square
    radians, along either axis), radiance [L, 3].
    """

    texels: NDArray[np.int64]
    owner: NDArray[np.int64]
    direction: NDArray[np.float32]
    solid_angle: NDArray[np.float32]
    variance: NDArray[np.float32]
    radiance: NDArray[np.float32]


def bright_parts(tree: LightTree, resolution: int) -> BrightParts:
    """The bright texels of a cube of `resolution`, a level of the tree; none where light comes from everywhere.

    The leaves are found from the texels down: whichever spreads most light over the widest angle is cut first.
    """
    shape, place = tree.shape, tree.place.detach().cpu().numpy()
    start = sum(6 * n * n for n in _finer(shape.resolution, resolution))
    share = place[start : start + 6 * resolution**2, 4]
    bright = np.flatnonzero(share > CONCENTRATION / len(share))
    texels = np.sort(bright[np.argsort(-share[bright], kind="stable")[:MOST_TEXELS]])
    waiting = [(-_spread(place[start + t]), int(start + t), k) for k, t in enumerate(texels)]
    heapq.heapify(waiting)
    while waiting and len(waiting) < MOST_LEAVES - 3 and waiting[0][0] < 0:
        _, node, owner = heapq.heappop(waiting)
        for child in shape.child[node]:
            spread = _spread(place[child]) if shape.child[child, 0] >= 0 else 0.0
            heapq.heappush(waiting, (-spread, int(child), owner))
    nodes, owners = (np.array([w[k] for w in waiting], np.int64) for k in (1, 2))
    radiance = tree.radiance.detach().cpu().numpy()[nodes]
    at = place[nodes].reshape(-1, 5)
    return BrightParts(texels, owners, at[:, :3], shape.solid_angle[nodes], at[:, 3], radiance.reshape(-1, 3))


def _finer(resolution: int, coarse: int) -> list[int]:
    """Resolutions of the tree's levels below the one of `coarse`."""
    sizes = []
    while resolution > coarse:
        sizes.append(resolution)
        resolution //= 2
    return sizes


def _spread(place: NDArray) -> float:
    """Light times variance of a node; 0 where it is narrow enough."""
    return float(place[4] * place[3]) if place[3] > NARROW else 0.0
