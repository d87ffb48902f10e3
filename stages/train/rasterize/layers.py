"""Layered blending: splats within `layer` of the first hit are averaged as one surface instead of occluding each other.

Front to back, the nearest splat of a surface hides the others. On a curved surface those are the ones that lean towards the
camera, so every blended normal leans that way too. Here a surface shows its splats' mean, weighted by alpha, and hides what
is behind as much as it would front to back.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor

from . import constants as k


def layer_numbers(alpha: Tensor, z: Tensor, pixel: Tensor, layer: float) -> tuple[Tensor, Tensor]:
    """Which layer of its pixel a splat belongs to, and whether it counts at all. [M] each

    alpha > 0, camera z and pixel [M], pixels one after the other and each front to back. A layer ends at the first splat met
    more than `layer` behind the one that began it. The pixel ends instead where less than `TRANSMITTANCE_STOP` is left, or
    at once before `LEAST_TRANSMITTANCE`. The last of `MAX_LAYERS` layers holds all that follows.
    """
    _, run, length = torch.unique_consecutive(pixel, return_inverse=True, return_counts=True)
    place = torch.arange(len(alpha), device=alpha.device)
    end = torch.cumsum(length, 0)
    begin = end - length
    log_left = torch.cumsum(torch.log1p(-alpha.double()), 0)
    log_left = torch.cat((log_left.new_zeros(1), log_left))  # before each splat and after the last
    spent = log_left[:-1] - log_left[begin][run] < math.log(k.TRANSMITTANCE_STOP)
    drained = log_left[1:] - log_left[begin][run] < math.log(k.LEAST_TRANSMITTANCE)
    end = _first(place, run, drained, end)
    number = torch.zeros_like(place)
    goes_on = torch.ones_like(begin, dtype=torch.bool)
    for _ in range(k.MAX_LAYERS - 1):
        farther = goes_on[run] & (place > begin[run]) & (place < end[run]) & (z > z[begin][run] + layer)
        after = _first(place, run, farther, end)
        goes_on = goes_on & (after < end)
        end = torch.where(goes_on & spent[after.clamp(max=len(z) - 1)], after, end)
        goes_on = goes_on & (after < end)
        begin = torch.where(goes_on, after, begin)
        number = number + (goes_on[run] & (place >= begin[run]))
    farther = goes_on[run] & (place > begin[run]) & (place < end[run]) & (z > z[begin][run] + layer)
    end = _first(place, run, farther & spent, end)
    return number, place < end[run]


def _first(place: Tensor, run: Tensor, condition: Tensor, end: Tensor) -> Tensor:
    """Of each run, the first place where the condition holds, else its end."""
    return end.scatter_reduce(0, run[condition], place[condition], "amin")


def layer_weights(alpha: Tensor, number: Tensor, pixel: Tensor) -> tuple[Tensor, Tensor]:
    """Blending weights of splats with their opacity alpha, layer number and pixel, and what they would be alone. [M] each

    A layer of transmittance t covers 1 - t of what the layers before let through, shared out by alpha.
    """
    if not len(pixel):
        return alpha, alpha
    sums = alpha.new_zeros(int(pixel.max()) + 1, k.MAX_LAYERS)
    total = sums.index_put((pixel, number), alpha, accumulate=True)
    through = torch.exp(sums.index_put((pixel, number), torch.log1p(-alpha), accumulate=True))
    before = torch.cumprod(torch.cat((torch.ones_like(through[:, :1]), through[:, :-1]), 1), 1)
    share = before * (1 - through) / torch.where(total > 0, total, torch.ones_like(total))
    return alpha * share[pixel, number], alpha * before[pixel, number]
