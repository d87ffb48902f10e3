"""One run of the pipeline with other parameters: its seconds and its error against the run with the user's own."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from stages.metrics.comparison.results import Result

FIGURES = {
    "train": ("psnr_srgb", "psnr_srgb_behind_polariser", "normal_mae_deg", "aolp_mae_deg"),
    "mesh": ("chamfer_pct",),
    "relight": ("psnr_srgb",),
    "olat": ("normal_median_deg", "albedo_rel_median", "residual_median"),
}
"""What a run's error is made of, where a capture has it: without truth, held-out views (train), the fit's residual (olat)."""


@dataclass(frozen=True)
class Measured:
    """A run: parameters that differ from the user's, seconds of every stage without those of compiling kernels (which happens
    once on a machine), and its error over that of the user's run (1). `pace`: wall seconds of a processor second, by stage."""

    changed: dict[str, Any]
    seconds: dict[str, float]
    error: float
    figures: dict[str, float] = field(default_factory=dict)
    pace: dict[str, float] = field(default_factory=dict)

    @property
    def total(self) -> float:
        """Seconds of all stages."""
        return sum(self.seconds.values())


def errors(metrics: Mapping[str, Any]) -> dict[str, float]:
    """The figures of `FIGURES` as errors: decibels as root mean squares."""
    out = {}
    for stage, names in FIGURES.items():
        table = metrics.get(stage, {})
        parts = {stage: table}
        if stage == "relight":
            parts = {f"relight {k}": v for k, v in table.items() if isinstance(v, Mapping)}
        for part, values in parts.items():
            for name in names:
                value = values.get(name) if isinstance(values, Mapping) else None
                if isinstance(value, int | float) and value > 0:
                    out[f"{part}: {name}"] = 10 ** (-value / 20) if "psnr" in name else float(value)
    return out


def measured(result: Result, changed: Mapping[str, Any], base: Mapping[str, float], pace: Mapping[str, float]) -> Measured:
    """A finished run beside the errors `base` of the user's own: the geometric mean of their ratios; 1 if they share none.

    Its seconds are those of the processor at the user's run's `pace`: what else the machine did meanwhile does not count.
    """
    own = errors(result.metrics)
    shared = [math.log(own[k] / base[k]) for k in base if k in own]
    times = {stage: taken(manifest) for stage, manifest in result.manifests.items()}
    own_pace = {stage: wall / cpu if cpu > 0 else 1.0 for stage, (wall, cpu) in times.items()}
    seconds = {stage: cpu * pace.get(stage, own_pace[stage]) if cpu > 0 else wall for stage, (wall, cpu) in times.items()}
    return Measured(dict(changed), seconds, math.exp(sum(shared) / len(shared)) if shared else 1.0, own, own_pace)


def taken(manifest: Mapping[str, Any]) -> tuple[float, float]:
    """Wall and processor seconds of a stage without those of compiling, which is the work of one thread."""
    wall, cpu, compiled = (float(manifest.get(name) or 0.0) for name in ("wall_s", "cpu_s", "compile_s"))
    share = min(1.0, cpu / wall) if wall > 0 else 1.0
    return max(wall - compiled, 0.0), max(cpu - compiled * share, 0.0)
