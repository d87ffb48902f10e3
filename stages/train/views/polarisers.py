"""Polarisers in front of the physical cameras: intensity from Stokes, closed-form angle estimates, their precision."""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch

from pipeline.capture.model import PolariserPrior

UNKNOWN_STD = math.pi / math.sqrt(12)  # of an angle of which nothing is known, radians
BENT = 7.5  # true error over the jackknife's: root mean square over 8 angles of 4 captures, each 1.8 to 9.5 (700 steps)
SAME_ANGLE_DEG = 2.0  # two polarisers nearer than this measure the same component


@dataclass(frozen=True)
class PolariserState:
    """One polariser: angle (degrees, 0..180), standard deviation (None: not estimated), whether it is trusted as given,
    and contrast (1 - 1/extinction) / (1 + 1/extinction)."""

    angle_deg: float
    std_deg: float | None
    trusted: bool
    contrast: float


class PolariserBank:
    """Angles of every physical camera's polariser; one raw tensor (radians), in the order of the sorted names."""

    def __init__(self, priors: Mapping[str, PolariserPrior], names: list[str], device: str = "cpu") -> None:
        self.names = sorted(names)
        angles, contrast, trusted, known = [], [], [], []
        for name in self.names:
            prior = priors.get(name, PolariserPrior())
            angles.append(math.radians(prior.angle_deg or 0.0))
            known.append(prior.angle_deg is not None)
            trusted.append(prior.trusted and prior.angle_deg is not None)
            leak = 1 / prior.extinction if prior.extinction else 0.0
            contrast.append((1 - leak) / (1 + leak))
        self.trusted, self.known = trusted, known
        self.contrast = torch.tensor(contrast, device=device)
        self.free = torch.tensor([0.0 if t else 1.0 for t in trusted], device=device)
        self.angles = torch.tensor(angles, device=device, requires_grad=not all(trusted))
        self.std_deg: list[float | None] = [None] * len(self.names)
        self.settled = list(known)  # an unknown angle counts for nothing until it has been estimated

    def intensity(self, stokes: torch.Tensor, name: str) -> torch.Tensor:
        """Twice the intensity behind the polariser (an unpolarised scene then gives s0), [P, 3] from [P, 3, 3].

        Row 0 of PhyGaP Eq. 31, times 2; a finite extinction ratio lowers the contrast.
        """
        k = self.names.index(name)
        if not self.settled[k]:
            return stokes[:, 0]
        angle = self.angles[k] * 2
        part = torch.cos(angle) * stokes[:, 1] + torch.sin(angle) * stokes[:, 2]
        return stokes[:, 0] + self.contrast[k] * part

    def mix(self, name: str) -> tuple[float, float]:
        """(m1, m2) of `intensity` = s0 + m1 s1 + m2 s2 as it stands now."""
        k = self.names.index(name)
        if not self.settled[k]:
            return 0.0, 0.0
        angle, contrast = 2 * float(self.angles[k].detach()), float(self.contrast[k])
        return contrast * math.cos(angle), contrast * math.sin(angle)

    def set_angle(self, name: str, radians: float) -> None:
        """Overwrite one angle (not a trusted one); it is in use from now on."""
        k = self.names.index(name)
        self.settled[k] = True
        if not self.trusted[k]:
            with torch.no_grad():
                self.angles[k] = radians % math.pi

    def result(self) -> dict[str, PolariserState]:
        """Angles in [0, 180) with their precision."""
        out = {}
        for k, name in enumerate(self.names):
            angle = math.degrees(float(self.angles[k].detach())) % 180.0
            out[name] = PolariserState(angle, self.std_deg[k], self.trusted[k], float(self.contrast[k]))
        return out

    def undetermined(self) -> str | None:
        """Why the Stokes vectors are not determined by these angles, or None."""
        state = list(self.result().values())
        if len(state) == 1:
            return "one polariser angle alone leaves the polarisation to what many views of one surface imply"
        angles = [s.angle_deg for s in state]
        apart = max(abs((a - b + 90) % 180 - 90) for a in angles for b in angles)
        if apart < SAME_ANGLE_DEG:
            return "all polarisers stand at the same angle (modulo 180 degrees)"
        return None


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
    views and cannot be seen in their scatter; BENT is its root as measured.
    """
    total = functools.reduce(AngleSums.plus, views, AngleSums.empty())
    fit = fit_angle(total, contrast)
    if len(views) < 2:
        return replace(fit, std=UNKNOWN_STD)
    without = [fit_angle(total.plus(view, -1.0), contrast).angle for view in views]
    off = np.array([(angle - fit.angle + math.pi / 2) % math.pi - math.pi / 2 for angle in without])
    jackknife = math.sqrt((len(off) - 1) / len(off) * float(((off - off.mean()) ** 2).sum()))
    return replace(fit, std=min(max(fit.std, BENT * jackknife), UNKNOWN_STD))
