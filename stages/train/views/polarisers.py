"""Polarisers in front of the physical cameras: their angles, and the intensity behind them from Stokes vectors."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import torch

from pipeline.capture.model import PolariserPrior

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
