"""Parameters of the olat stage."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

Solver = Literal[
    "closed", "gradient", "lbfgs-backtracking", "lbfgs-zoom", "lbfgs-hager-zhang", "gd", "ncg", "gauss-newton",
    "optimistix-lbfgs", "optimistix-bfgs", "optimistix-ncg", "optimistix-gauss-newton", "optimistix-levenberg-marquardt",
    "optax-lbfgs",
]  # fmt: skip


@dataclass(frozen=True)
class OlatParameters:
    """How the frames become maps. The defaults are the better forms; `docs/light_stage.md` says what each option costs."""

    solver: Solver = field(
        default="closed",
        metadata={"help": "closed forms and Newton; gradient: Ma et al. 2007; others: general solvers on PRF's objectives"},
    )
    lobe: Literal["auto", "ward", "beckmann", "ggx", "printed", "printed-cosine"] = field(
        default="auto", metadata={"help": "specular lobe; auto: Ward, Beckmann or GGX, whichever fits the capture best"}
    )
    diffuse_fit: Literal["robust", "active-set"] = field(
        default="robust", metadata={"help": "robust: told from shadow and inter-reflection; active-set: PRF Eq. 12 as printed"}
    )
    specular_fit: Literal["joint", "half-vector", "correlation"] = field(
        default="joint", metadata={"help": "n_s: fitted with the lobe; weighted half vectors; correlation: PRF Eq. 13"}
    )
    fusion: Literal["variance", "correlation"] = field(
        default="variance", metadata={"help": "weights of n_d and n_s: inverse variance; correlation: PRF's rule"}
    )
    overexposure: Literal["bound", "remove", "off"] = field(
        default="bound",
        metadata={
            "help": "samples marked clipped bound the lobe from below; remove: PRF Alg. 1 on them; off: taken as they are"
        },
    )
    overexposure_gap: float = field(
        default=0.1, metadata={"help": "PRF Alg. 1's epsilon: gap, of a pixel's brightest sample, that makes samples spikes"}
    )
    overexposure_rounds: int = field(default=2, metadata={"help": "PRF Alg. 1's M: how often spikes are taken down"})
    maps: Literal["normalised", "printed"] = field(
        default="normalised", metadata={"help": "occlusion and inter-reflection by solid angles; printed: PRF Eqs. 4 and 5"}
    )
    widths: Literal["surface", "pixel"] = field(
        default="surface", metadata={"help": "sigma: surface, without the spread of normals within a pixel; pixel, with it"}
    )
    albedo_over_occlusion: bool = field(default=False, metadata={"help": "divide the albedos by the occlusion maps (noisy)"})
    geometry: str = field(
        default="",
        metadata={
            "help": "mesh of this object: lights that it hides from a pixel are dark there, near ones lit its surface (file)"
        },
    )
    second_fit: Literal["auto", "on", "off"] = field(
        default="auto",
        metadata={"help": "fit again with the surface that the first fits show; auto: where lights are near (three cameras)"},
    )
    align: bool = field(
        default=True, metadata={"help": "undo a shift of the parallel pass against the crossed one, in whole pixels"}
    )
    lights: str = field(default="all", metadata={"help": "all, or every=k: each k-th light"})
    precision: Literal["float32", "float64"] = field(default="float32", metadata={"help": "arithmetic of the fits"})
    band_mb: float = field(default=96.0, metadata={"help": "samples held of one band of scanlines (MiB); two bands are held"})

    def __post_init__(self) -> None:
        """Raises ValueError on a light selection or a number without meaning, and on what a solver cannot do."""
        every(self.lights)
        if not self.band_mb > 0:
            raise ValueError(f"band_mb = {self.band_mb} is not above 0")
        if not 0 < self.overexposure_gap < 1:
            raise ValueError(f"overexposure_gap = {self.overexposure_gap} is not between 0 and 1")
        if self.overexposure_rounds < 1:
            raise ValueError(f"overexposure_rounds = {self.overexposure_rounds} is not above 0")
        if self.solver != "closed" and self.lobe not in ("auto", "ward"):
            raise ValueError(f"lobe = {self.lobe}: solver = {self.solver} has Ward's lobe alone; leave lobe out")
        if self.solver not in ("closed", "gradient") and self.precision != "float32":
            raise ValueError(f"precision = {self.precision}: solver = {self.solver} computes in float32; leave precision out")


def every(lights: str) -> int:
    """The k of `every=k`; 1 for all lights. Raises ValueError."""
    name, _, number = lights.partition("=")
    if lights == "all":
        return 1
    if name != "every" or not number.isdigit() or int(number) < 1:
        raise ValueError(f"lights = {lights!r} is neither all nor every=k with k from 1")
    return int(number)
