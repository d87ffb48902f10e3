"""Noise and clipping added to captures with known truth: what is left of normals, widths and tangents."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from benchmarks.olat_forms import captures
from benchmarks.olat_settings import AT, SETTINGS
from stages.olat.maps.footprint import with_neighbours
from stages.olat.pixel_fit.many_pixels import fit
from stages.olat.reading.scanline_bands import Band
from synth.olat_pixels import angle_deg

CASES = ((0.0, np.inf), (3e-3, 1.0), (1e-2, 1.0), (1e-2, 0.5), (3e-2, 2.0))
"""Standard deviation added to the stored samples, and their largest value."""
NEAR_CLIP = 0.98  # of the largest value: from here on samples count as clipped, as decode counts them


def table(folder: Path) -> list[dict[str, float | str]]:
    """Median errors of every light stage with ground truth in `folder` under `CASES`."""
    out: list[dict[str, float | str]] = []
    for name, (p, inside) in captures(folder).items():
        for noise, clip in CASES:
            rng = np.random.default_rng(5)
            cross, parallel = (np.minimum(x + noise * rng.normal(size=x.shape), clip) for x in (p.cross, p.parallel))
            settings = SETTINGS._replace(saturation=NEAR_CLIP * min(clip, float(parallel.max()) * 2))
            rows, _ = fit(cross.astype(np.float32), parallel.astype(np.float32), p.view, p.rig, settings)
            whole = Band(0, inside.shape[0], np.flatnonzero(inside))
            rows = next(with_neighbours([(whole, rows)], inside.shape[1]))[1]
            tangent = rows[:, AT["tangent"]]
            one_way = (np.linalg.norm(tangent, axis=1) > 0.5) & (p.sigma[:, 0] > p.sigma[:, 1])  # a round lobe has none
            angle = np.degrees(np.arccos(np.clip(np.abs(np.sum(tangent * p.tangent, 1)), 0, 1)))
            widths = np.median(rows[:, AT["sigma"]], 0) / p.sigma[0] - 1
            row: dict[str, float | str] = {
                "pixels": name, "noise": noise, "clip": min(clip, 1e9),
                "n_d_deg": float(np.median(angle_deg(rows[:, AT["diffuse_normal"]], p.normal))),
                "n_s_deg": float(np.median(angle_deg(rows[:, AT["specular_normal"]], p.normal))),
                "sigma_large": float(widths[0]), "sigma_small": float(widths[1]),
                "tangent_deg": float(np.median(angle[one_way])) if one_way.any() else -1.0,
                "tangent_share": float(one_way.mean()),
            }  # fmt: skip
            out.append(row)
            print(
                f"  {name:20} noise {noise:.0e} clip {clip:<4} n_d {row['n_d_deg']:.2f}  n_s {row['n_s_deg']:.2f}"
                f"  sigma {widths[0]:+.1%} {widths[1]:+.1%}  tangent {row['tangent_deg']:.1f} of {one_way.mean():.0%}",
                flush=True,
            )
    return out
