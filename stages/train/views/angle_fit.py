"""Closed-form polariser angles from what a model renders and the cameras measured, and how far to trust them."""

from __future__ import annotations

import functools
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch

from . import losses
from .polarisers import PolariserBank
from .view import View

UNKNOWN_STD = math.pi / math.sqrt(12)  # of an angle of which nothing is known, radians
# Standard deviation of a joint training's angle over the jackknife's: root mean square of the true error / the jackknife's
# standard deviation over 8 angles in 4 captures of known angles (700 steps), which range from 1.8 to 9.5.
JACKKNIFE_INFLATION = 7.5


@dataclass
class AngleSums:
    """Normal equations of `2 I - s0 = gain * contrast * (s1 cos 2t + s2 sin 2t)` for one polariser."""

    matrix: torch.Tensor
    right: torch.Tensor
    squared: float = 0.0
    count: float = 0.0

    @classmethod
    def empty(cls) -> AngleSums:
        """No data yet (float64: sums over many pixels)."""
        return cls(torch.zeros(2, 2, dtype=torch.float64), torch.zeros(2, dtype=torch.float64))

    def add(self, stokes: torch.Tensor, doubled_intensity: torch.Tensor, weight: torch.Tensor) -> None:
        """Take in pixels: model Stokes [P, 3, 3], measured 2 I [P, 3], weight [P, 1] or [P, 3]."""
        w = weight.expand_as(doubled_intensity).double().reshape(-1)
        a = (stokes[:, 1:] * 1.0).double().permute(0, 2, 1).reshape(-1, 2)
        b = (doubled_intensity - stokes[:, 0]).double().reshape(-1)
        self.matrix += (a * w[:, None]).T @ a
        self.right += (a * w[:, None]).T @ b
        self.squared += float((w * b * b).sum())
        self.count += float((w > 0).sum())

    def plus(self, other: AngleSums, sign: float = 1.0) -> AngleSums:
        """These pixels and the other's, or with `sign` -1 without them."""
        return AngleSums(
            self.matrix + sign * other.matrix,
            self.right + sign * other.right,
            self.squared + sign * other.squared,
            self.count + sign * other.count,
        )


@dataclass(frozen=True)
class AngleFit:
    """Angle in radians (0..pi) and its standard deviation in radians.

    The deviation is of independent pixels where `fit_angle` gives it, honest where `fit_views` does.
    """

    angle: float
    std: float


def fit_angle(sums: AngleSums, contrast: float) -> AngleFit:
    """Least-squares angle on the circle |(cos 2t, sin 2t)| = contrast: a dense scan, then Newton steps.

    The scan cannot be caught in the wrong one of the two minima that a quadratic has on a circle.
    """
    t = torch.linspace(0, math.pi, 721, dtype=torch.float64)[:-1]

    def cost(angle: torch.Tensor) -> torch.Tensor:
        u = contrast * torch.stack([torch.cos(2 * angle), torch.sin(2 * angle)], -1)
        return sums.squared - 2 * (u @ sums.right) + ((u @ sums.matrix) * u).sum(-1)

    costs = cost(t)
    best = int(costs.argmin())
    left, mid, right = costs[best - 1], costs[best], costs[(best + 1) % len(t)]
    bend = float(left - 2 * mid + right)
    step = math.pi / 720
    shift = 0.5 * float(left - right) / bend if bend > 0 else 0.0
    angle = (float(t[best]) + shift * step) % math.pi
    curvature = bend / step**2 / 2  # half the second derivative
    residual = max(float(mid), 0.0) / max(sums.count - 1, 1.0)
    std = math.sqrt(residual / curvature) if curvature > 0 else math.pi
    return AngleFit(angle, min(std, math.pi))


def fit_views(views: Sequence[AngleSums], contrast: float) -> AngleFit:
    """Least-squares angle of all views' pixels, with a standard deviation that true errors bear out.

    Pixels are not independent: what keeps a fit from the truth is the model's normals and light, wrong alike over whole
    views, so a million residuals gave 0.02 degrees for errors of 1. The jackknife over views (each left out in turn; Efron
    and Stein 1981) counts views instead, var = (V - 1)/V sum (t_v - mean)^2. It still takes the model as given, while the
    model has bent to the angle: with Fisher information I_tt for the angle, I_mm for the model and I_tm between them, the
    fit knows the angle to 1/I_tt but joint training only to 1/(I_tt - I_tm I_mm^-1 I_mt). That factor is the same in all
    views and cannot be seen in their scatter; JACKKNIFE_INFLATION is its root as measured.
    """
    total = functools.reduce(AngleSums.plus, views, AngleSums.empty())
    fit = fit_angle(total, contrast)
    if len(views) < 2:
        return replace(fit, std=UNKNOWN_STD)
    without = [fit_angle(total.plus(view, -1.0), contrast).angle for view in views]
    off = np.array([(angle - fit.angle + math.pi / 2) % math.pi - math.pi / 2 for angle in without])
    jackknife = math.sqrt((len(off) - 1) / len(off) * float(((off - off.mean()) ** 2).sum()))
    return replace(fit, std=min(max(fit.std, JACKKNIFE_INFLATION * jackknife), UNKNOWN_STD))


def view_sums(bank: PolariserBank, view: View, stokes: torch.Tensor) -> AngleSums:
    """Normal equations of one view's pixels, its rendering [P, 3, 3] against what it measured.

    Weights are those of iteratively reweighted least squares: the fit then minimises what training minimises, and the few
    pixels that the model cannot explain do not turn the angle.
    """
    measured = 2 * view.target[:, 0]
    slope = losses.encode_slope(measured)
    residual = slope * (measured - bank.intensity(stokes, view.camera.name))
    robust = torch.rsqrt(residual**2 + losses.CHARBONNIER**2)
    weight = slope**2 * robust * (view.colour_weight * view.inside)[:, None]
    sums = AngleSums.empty()
    sums.add(stokes, measured, weight)
    return sums


def fit_angles(bank: PolariserBank, rendered: Iterable[tuple[View, torch.Tensor]]) -> dict[str, AngleFit]:
    """Angle of every polariser of the bank from views and their Stokes renderings [P, 3, 3]."""
    sums: dict[str, list[AngleSums]] = {name: [] for name in bank.names}
    for view, stokes in rendered:
        sums[view.camera.name].append(view_sums(bank, view, stokes))
    return {name: fit_views(sums[name], float(bank.contrast[k])) for k, name in enumerate(bank.names)}
