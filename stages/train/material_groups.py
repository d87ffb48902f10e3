"""Groups of splats of one colour, whose roughness and IoR move together: two materials of an object mostly differ in albedo.

What all splats of a colour agree on is lost in the noise of each splat's own gradient, as what all splats agree on would be
without a shared value (`splats.gaussians`). A common step for each group sees the sum.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from pipeline.formats.images import srgb_encode

from .splats.gaussians import SplatModel
from .splats.optimiser import adam_update

APART = 4.0  # standard deviations between the means of two groups, at least. Halves of a bell lie 2.6 of theirs apart, those of
# an even spread 3.5: one colour, however uneven, is not divided
LEAST_SHARE = 0.05
"""Of the splats in a group: fewer may be the blends at a border, a cavity that no light is known of, or a fleck."""
MOST_GROUPS = 8
ROUNDS = 20  # of moving the dividing plane of two groups to the middle of their means; it rests after a few
LEAST_SPREAD = 0.02  # sRGB, 0..1: standard deviation that a group has at least, or blends at a sharp border were a colour
HELD = 0.3  # share of a group's mean that is held back with its splats' offsets (a tenth of the square): the pull that two
# materials of roughness 0.32 and 0.55 feel is then a thirtieth of what the images gain by telling them apart
OFFSETS = ("roughness_offset", "ior_offset")


def colour_groups(albedo: NDArray) -> NDArray[np.int64]:
    """Divide colours [N, 3] (linear, 0..1) where they fall apart into clusters: group numbers [N] from 0; all 0 where not."""
    colours = srgb_encode(albedo).astype(np.float64)
    label = np.zeros(len(colours), np.int64)
    least = max(1, round(LEAST_SHARE * len(colours)))
    found, group = 1, 0
    while group < found:
        rows = np.flatnonzero(label == group)
        half = _halves(colours[rows], least) if found < MOST_GROUPS else None
        if half is None:
            group += 1
            continue
        label[rows[half]] = found
        found += 1
    return label


def _halves(colours: NDArray, least: int) -> NDArray[np.bool_] | None:
    """Which of the colours [N, 3] belong to the second of two clusters, or None where there is but one."""
    if len(colours) < 2 * least:
        return None
    centred = colours - colours.mean(0)
    axis = np.linalg.eigh(centred.T @ centred)[1][:, -1]
    along = centred @ axis
    cut = 0.5 * (along.min() + along.max())
    for _ in range(ROUNDS):
        upper = along > cut
        if min(upper.sum(), (~upper).sum()) < least:
            return None
        low, high = along[~upper].mean(), along[upper].mean()
        cut = 0.5 * (low + high)
    inner = (along[upper].var() * upper.sum() + along[~upper].var() * (~upper).sum()) / len(along)
    return upper if high - low > APART * np.sqrt(inner + LEAST_SPREAD**2) else None


@dataclass(frozen=True)
class Groups:
    """Which group each splat belongs to [N], and how many splats each has [G]."""

    of: torch.Tensor
    members: torch.Tensor

    @classmethod
    def numbered(cls, of: torch.Tensor) -> Groups:
        """Groups of these numbers, from 0."""
        return cls(of, torch.bincount(of))

    def sums(self, values: torch.Tensor) -> torch.Tensor:
        """Sums of per-splat values [N, C] by group [G, C]."""
        return values.new_zeros(len(self.members), values.shape[1]).index_add(0, self.of, values)

    def held(self, values: torch.Tensor) -> torch.Tensor:
        """What of values [N, C] is a splat's own, and HELD of its group's mean."""
        means = self.sums(values) / self.members[:, None]
        return values - (1 - HELD) * means.index_select(0, self.of)


@torch.no_grad()
def groups_of(model: SplatModel) -> Groups | None:
    """The splats grouped by their albedo as it is; None where all are of one colour."""
    albedo = torch.sigmoid(model["albedo"].detach())
    found = colour_groups(albedo.cpu().numpy())
    return Groups.numbered(torch.as_tensor(found, device=albedo.device)) if found.any() else None


class GroupStep:
    """Adam on one value a group and offset, added to the offsets of all its splats. `moments` [2, G, 2]; `steps` so far."""

    def __init__(self) -> None:
        self.moments: torch.Tensor | None = None
        self.steps = 0

    @torch.no_grad()
    def step(self, model: SplatModel, groups: Groups, rates: Sequence[float]) -> None:
        """Move the offsets in place, by `rates` of OFFSETS; call it while their gradients are still there.

        Gradients that are not finite count as 0; each splat's own step counts them for the user (`splats.optimiser`).
        """
        offsets = [model[name] for name in OFFSETS]
        given = [torch.zeros_like(t) if t.grad is None else t.grad for t in offsets]
        gradient = groups.sums(torch.nan_to_num(torch.stack(given, -1), nan=0.0, posinf=0.0, neginf=0.0))
        if self.moments is None or self.moments.shape[1] != len(groups.members):
            self.moments, self.steps = gradient.new_zeros(2, *gradient.shape), 0
        self.steps += 1
        first, second = self.moments
        moved = adam_update(first, second, gradient, self.steps)[groups.of]
        for tensor, rate, step in zip(offsets, rates, moved.unbind(-1)):
            tensor.sub_(step, alpha=rate)

    def state(self) -> dict[str, Any]:
        """Everything a resume needs."""
        return {"moments": None if self.moments is None else self.moments.clone(), "steps": self.steps}

    def load(self, state: dict[str, Any]) -> None:
        """Take over a saved state."""
        self.moments, self.steps = state["moments"], state["steps"]
