"""Olat: one-light-at-a-time frames behind crossed and parallel polarisers to reflectance maps."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from pipeline.capture import Capture
from pipeline.engine.stage import Decision, Stage, StageRun

Solver = Literal[
    "closed", "lbfgs-backtracking", "lbfgs-zoom", "lbfgs-hager-zhang", "gd", "ncg", "gauss-newton", "gradient"
]  # fmt: skip


@dataclass(frozen=True)
class OlatParameters:
    """How the frames become maps. The defaults are the better forms; `docs/light_stage.md` says what each option costs."""

    solver: Solver = field(
        default="closed",
        metadata={"help": "closed forms and Newton; a jaxopt solver on PRF's own objectives; gradient: Ma et al. 2007"},
    )
    lobe: Literal["auto", "ward", "beckmann", "printed", "printed-cosine"] = field(
        default="auto", metadata={"help": "specular lobe; auto: Ward or Beckmann, whichever fits the capture better"}
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
    maps: Literal["normalised", "printed"] = field(
        default="normalised", metadata={"help": "occlusion and inter-reflection by solid angles; printed: PRF Eqs. 4 and 5"}
    )
    widths: Literal["surface", "pixel"] = field(
        default="surface", metadata={"help": "sigma: surface, without the spread of normals within a pixel; pixel, with it"}
    )
    albedo_over_occlusion: bool = field(default=False, metadata={"help": "divide the albedos by the occlusion maps (noisy)"})
    align: bool = field(
        default=True, metadata={"help": "undo a shift of the parallel pass against the crossed one, in whole pixels"}
    )
    lights: str = field(default="all", metadata={"help": "all, or every=k: each k-th light"})
    precision: Literal["float32", "float64"] = field(default="float32", metadata={"help": "arithmetic of the fits"})
    band_mb: float = field(default=96.0, metadata={"help": "samples held of one band of scanlines (MiB); two bands are held"})

    def __post_init__(self) -> None:
        """Raises ValueError on a light selection or a band size without meaning."""
        every(self.lights)
        if not self.band_mb > 0:
            raise ValueError(f"band_mb = {self.band_mb} is not above 0")


def every(lights: str) -> int:
    """The k of `every=k`; 1 for all lights. Raises ValueError."""
    name, _, number = lights.partition("=")
    if lights == "all":
        return 1
    if name != "every" or not number.isdigit() or int(number) < 1:
        raise ValueError(f"lights = {lights!r} is neither all nor every=k with k from 1")
    return int(number)


def needed(capture: Capture, parameters: OlatParameters) -> Decision:
    """Where the capture is a light stage."""
    stage = capture.light_stage
    if stage is None:
        return Decision(False, "no one-light-at-a-time frames")
    near = capture.config.olat.near_light
    passes = {
        "overexposure": Decision(
            parameters.overexposure != "off", "on the samples that decode finds clipped, if any"
            if parameters.overexposure != "off" else "olat.overexposure=off"
        ),
        "near light": Decision(near, "near_light is set" if near else "lights are distant (near_light is not set)"),
        "jax": Decision(
            parameters.solver not in ("closed", "gradient"), f"solver {parameters.solver}"
        ),
    }  # fmt: skip
    cameras = f"{len(stage.cameras)} camera{'s' * (len(stage.cameras) != 1)}"
    return Decision(True, f"{cameras} under {len(stage.lights)} lights, cross and parallel", passes)


def capture_files(capture: Capture) -> Iterable[Path]:
    """The frames themselves: decode leaves only an index of them."""
    stage = capture.light_stage
    if stage is None:
        return []
    return [path for camera in stage.cameras.values() for path in (*camera.cross, *camera.parallel)]


def run(stage: StageRun) -> None:
    """Write camNN/ with its maps and preview.png for every camera."""
    from stages.olat.reading.stream import reading

    with reading(stage) as lanes:
        from stages.olat.run import run as fit_all  # the frames are on their way meanwhile

        fit_all(stage, lanes)


STAGE = Stage(
    name="olat",
    version=6,
    parameters=OlatParameters,
    needs=("decode", "masks"),
    needed=needed,
    run=run,
    capture_files=capture_files,
    config=("olat", "radiometry"),
)
