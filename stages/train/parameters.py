"""Parameters of the train stage: one frozen dataclass, a help string and a unit for each."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, ClassVar, Literal

from pipeline.capture.model import Polarisation
from pipeline.optics.model_names import AnchorPlaces, AnchorWeights, Distribution, Fresnel, Indirect, Mirror

PAPER: dict[str, Any] = {
    "losses": "printed",
    "weight_dssim": 0.2,
    "weight_polarisation": 10.0,
    "weight_mask": 0.4,
    "weight_depth_normal": 0.2,
    "weight_smooth": 0.1,
    "weight_environment": 0.0,
    "fresnel": "schlick",
    "lobe": "ggx",
    "mirror": "split",
    "indirect": "gridmap",
    "environment_activation": "printed",
    "environment_resolution": 64,
    "concavities": "off",
}
"""PhyGaP's loss terms and weights (Eq. 10, 9.1), shading (Eqs. 15-20), GridMap and environment (Eq. 33, 6 x 64^2); what it does
not have is off. Start, rasteriser, optimiser and schedule stay this program's."""


LEAST_COARSE = 8000  # pixels of the object that images of half the size must still show: a step on 192 x 192 costs more for
# its splats than for its pixels, and half of that loses shape (the teapot) without gaining time
USUAL_SPLATS = 34000  # that there may be whatever the images' size
SPLATS_PER_PIXEL = 1.6  # of the object in a view, that there may be of larger images: at 192 x 192, 93 000 splats leave Spot's
# normals at 1.53 degrees, 31 000 at 1.24
FEWER_NUMBERS = 1.5
"""A view without full Stokes holds a third of the numbers and tells angles and IoR only together with shape: this many times
the steps, of rates that much smaller. With Stokes' own a messy capture behind two polarisers ends with IoR 0.035 and angles 2.3
and 2.4 degrees off instead of 0.012, 1.1 and 1.8; with the smaller rates and no more steps 0.026, 1.9 and 2.1."""


def _p(default: Any, text: str) -> Any:
    return field(default=default, metadata={"help": text})


@dataclass(frozen=True)
class TrainParameters:
    """How the model is trained. Lengths are relative to the object's size: the scene is normalised first."""

    PRESETS: ClassVar[dict[str, dict[str, Any]]] = {"ours": {}, "paper": PAPER}
    """Values of what is not given, by `preset`."""

    preset: Literal["ours", "paper"] = field(
        default="ours", metadata={"help": "defaults of what is not given: this program's, or PhyGaP's method as it is printed"}
    )
    iterations: int = _p(
        1000, "optimisation steps, one training view each; half as many again where views hold no full Stokes vectors (count)"
    )
    max_minutes: float = _p(0.0, "stop refining after this much training time; 0 = no limit (minutes)")
    seed: int = _p(0, "seed of every random choice")
    max_splats: int = _p(
        120000, "upper bound of the number of Gaussians, for memory and time; `splat_pixels` tells how many (count)"
    )
    densify: bool = _p(True, "remove splats that never show and add some where the images pull hardest")
    concavities: Literal["auto", "on", "off"] = _p(
        "auto", "look for hollows that no silhouette shows, by what the images agree on at other depths; auto: with full Stokes"
    )
    start: Literal["auto", "hull", "points"] = _p(
        "auto", "start from the masks' visual hull or from sparse points of the poses stage (inside it); auto: the better"
    )
    start_fraction: float = _p(0.8, "share of the splats to start with; the rest is for densification (fraction)")
    splat_pixels: float = _p(0.9, "wanted distance between neighbouring Gaussians (pixels of the training images)")
    pixels_per_splat: float = _p(
        0.0, "pixels of a view that a step looks at, for each splat that faces it, until the last phase; 0 = all (pixels)"
    )
    hull_resolution: int = _p(112, "voxels along the longest side of the visual hull (count)")
    coarse_fraction: float = _p(
        0.3,
        "share of the steps that see images of half the size, if these show enough of the object; 1: all, always (fraction)",
    )
    consolidate_fraction: float = _p(0.15, "share of the steps at the end that see every training view (fraction)")
    validation_every: int = _p(0, "hold back every n-th training view for early stopping; 0 = automatic (views)")
    validate_steps: int = _p(200, "steps between validations (steps)")
    patience: int = _p(4, "validations without a gain before the run goes to consolidation (count)")
    patience_db: float = _p(0.02, "smallest validation gain that counts (dB)")
    checkpoint_s: float = _p(20.0, "time between checkpoints (s)")

    polarisation: Literal["auto", Polarisation] = _p("auto", "which polarisation data to use")
    olat_priors: Literal["auto", "off"] = _p(
        "auto", "take what a light stage in the capture's folder olat/ measured as priors; auto: where there is one"
    )
    fresnel: Fresnel = field(default="exact", metadata={"help": "Fresnel model of the radiance"})
    lobe: Distribution = field(default="beckmann", metadata={"help": "microfacet distribution of the specular lobe"})
    mirror: Mirror = field(
        default="lobe-24",
        metadata={"help": "mirrored light: a sum over facets, over a tree of texels, or the split sum (always with schlick)"},
    )
    environment_activation: Literal["exponential", "printed"] = field(
        default="exponential",
        metadata={
            "help": "radiance of the environment's parameters: their exponential, with a common step of light against albedo; "
            "or PhyGaP's Eq. 33 without one"
        },
    )
    environment_resolution: int = _p(32, "texels along a side of the environment cube's faces (texels)")
    indirect: Indirect = field(
        default="traced",
        metadata={
            "help": "light that the object hides from and sends to itself: traced (shadows, one bounce), gridmap (PhyGaP's "
            "local environments), sh (learnt by every Gaussian, for mirrored light, as Ref-Gaussian), none; left out where "
            "the object hides nothing"
        },
    )
    gridmap_weights: AnchorWeights = field(
        default="inverse-square", metadata={"help": "weights of GridMap's anchors: 1/d^2, or d as Eq. 9 prints it"}
    )
    gridmap_anchors: AnchorPlaces = field(
        default="box", metadata={"help": "where GridMap's anchors stand: on the bounding box, or close to the surface (10.4)"}
    )

    losses: Literal["encoded", "printed"] = field(
        default="encoded",
        metadata={
            "help": "form of the losses of Eq. 10: of display-encoded radiance and over the surface graph, or as printed: of "
            "linear radiance and of images"
        },
    )
    weight_rgb: float = _p(1.0, "weight of the radiance loss L_rgb (Eq. 10)")
    weight_dssim: float = _p(0.0, "share of structural dissimilarity in L_rgb; the rest is pixelwise (fraction)")
    weight_polarisation: float = _p(8.0, "weight of the Stokes loss relative to the radiance loss (lambda 1)")
    weight_mask: float = _p(0.4, "weight of the mask loss (lambda 2)")
    weight_depth_normal: float = _p(0.06, "weight of the agreement of normals with positions (lambda 3)")
    weight_smooth: float = _p(0.02, "weight of the smoothness of normals, albedo and material (lambda 4)")
    weight_environment: float = _p(3.0, "weight of the environment's smoothness prior (relative)")

    def __post_init__(self) -> None:
        if self.iterations < 1:
            raise ValueError("iterations must be at least 1")
        if not 0 <= self.seed < 2**63:
            raise ValueError("seed must be at least 0 and fit into 63 bits")
        if self.environment_resolution not in (8, 16, 32, 64, 128):
            raise ValueError("environment_resolution must be 8, 16, 32, 64 or 128")
        if not 0.3 <= self.splat_pixels <= 10:
            raise ValueError("splat_pixels must lie between 0.3 and 10")
        if self.pixels_per_splat < 0:
            raise ValueError("pixels_per_splat must be at least 0")
        if not 0 <= self.weight_dssim <= 1:
            raise ValueError("weight_dssim must lie between 0 and 1")
        if self.max_splats < 100:
            raise ValueError("max_splats must be at least 100")

    def steps(self, mode: str) -> int:
        """Steps of a run: `iterations` with full Stokes vectors, more with fewer numbers a view ("polarisers", "none")."""
        return self.iterations if mode == "stokes" else round(FEWER_NUMBERS * self.iterations)

    def most_splats(self, covered: float) -> float:
        """Bound of the number of Gaussians where the object covers so many pixels of a view."""
        return min(self.max_splats, max(USUAL_SPLATS, SPLATS_PER_PIXEL * covered))

    def likely_splats(self, covered: float) -> float:
        """Number of Gaussians there, as of a ball, whose surface is four times its disc."""
        return min(self.most_splats(covered), 4 * covered / self.splat_pixels**2)

    def begins_coarse(self, covered: float) -> bool:
        """Whether the first steps see images of half the size, where the object covers so many pixels of a view."""
        return self.coarse_fraction >= 1 or (self.coarse_fraction > 0 and covered >= 4 * LEAST_COARSE)

    def searches_concavities(self, mode: str) -> bool:
        """Whether hollows are looked for in data of this mode ("stokes", "polarisers", "none")."""
        return self.concavities == "on" or (self.concavities == "auto" and mode == "stokes")
