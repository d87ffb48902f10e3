"""One depth per surface sample from a cost volume: neighbours agree unless the photographs speak against it."""

from __future__ import annotations

import numpy as np
from scipy import sparse
from scipy.spatial import cKDTree

NEIGHBOURS = 6
SAME_SIDE = 0.3  # cosine between normals above which two samples are neighbours
LEAST_VIEWS = 4  # fewer views than this agree on anything: normal and albedo have five unknowns in nine numbers a view
FLOOR = 0.002  # residual that counts as none: costs are logarithms, since noise scales a residual and depth does too
TENSION = 8.0  # cost of a difference in depth between neighbours, per unit of depth: a cup's wall is as steep as its rim
TEAR = 0.12  # difference beyond which more costs no more: a concavity may have a steep wall
STAY = 2.0  # cost of depth itself, per unit: what nothing speaks for stays where it is
ROUNDS = 25


def sample_depths(
    points: np.ndarray, normals: np.ndarray, depths: np.ndarray, residual: np.ndarray, views: np.ndarray
) -> np.ndarray:
    """Depth [P] below each sample (points, normals [P, 3]) that explains the views best, by min-sum message passing.

    depths [L] ascending from 0; residual, views [L, P]: `unexplained` and the number of views at each depth.
    """
    known = (views >= LEAST_VIEWS) & np.isfinite(residual)
    cost = np.log(np.where(known, residual, 1.0) + FLOOR)
    cost = cost - cost[0] + STAY * depths[:, None]
    worst = np.where(known, cost, -np.inf).max(0)
    cost = np.where(known, cost, worst)
    cost[:, ~known[0]] = 0.0  # what no view sees goes along with its neighbours
    unary = np.ascontiguousarray(cost.T)
    unary -= unary.min(1, keepdims=True)

    count, labels = unary.shape
    pairs = _neighbours(points, normals)
    source, target = np.concatenate([pairs, pairs[:, ::-1]]).T
    half = len(pairs)
    reverse = np.concatenate([np.arange(half) + half, np.arange(half)])
    gather = sparse.csr_matrix((np.ones(2 * half), (target, np.arange(2 * half))), (count, 2 * half))
    bend = TENSION * np.minimum(np.abs(depths[:, None] - depths[None]), TEAR)
    messages = np.zeros((2 * half, labels))
    for _ in range(ROUNDS):
        outgoing = (unary + gather @ messages)[source] - messages[reverse]
        new = np.min(outgoing[:, :, None] + bend[None], axis=1)
        new -= new.min(1, keepdims=True)
        messages = 0.5 * (messages + new)  # damped: messages around loops would swing otherwise
    chosen = depths[(unary + gather @ messages).argmin(1)]
    links = sparse.csr_matrix((np.ones(2 * half), (target, source)), (count, count)) + sparse.eye(count)
    return np.asarray(links @ chosen / links.sum(1).A1)


def _neighbours(points: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """Pairs i < j of samples beside each other on the same side of the surface [E, 2]."""
    index = cKDTree(points).query(points, k=min(NEIGHBOURS + 1, len(points)))[1][:, 1:]
    i, j = np.repeat(np.arange(len(points)), index.shape[1]), index.ravel()
    same = (normals[i] * normals[j]).sum(-1) > SAME_SIDE
    return np.unique(np.sort(np.stack([i[same], j[same]], -1), -1), axis=0)
