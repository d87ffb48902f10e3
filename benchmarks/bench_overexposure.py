"""PRF's ablation of its overexposure removal (Figs. 6 and 13 to 15), against truth: clipped captures with it and without it.

    python -m benchmarks.bench_overexposure [--captures FOLDER]

Compared are what the stage does (clipped samples bound the lobe from below), samples taken as they are (M = 0), and Algorithm 1
with M from 1 on and several epsilons, on the pixels that have a clipped sample: errors of normals, albedos and widths, and the
share of the parallel pass's light that was taken away. Light stages with ground truth in FOLDER are clipped as the synthetic
pixels are. The pictures are those of the paper's figures: albedo with and without, and what was removed.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.case_store import made_with
from benchmarks.olat_forms import captures
from benchmarks.olat_settings import AT, SETTINGS
from pipeline.formats.images import srgb_encode, write_png
from stages.olat.parameters import OlatParameters
from stages.olat.pixel_fit.many_pixels import fit, load
from synth.olat_pixels import Pixels, angle_deg, make

RESULTS = Path(__file__).parent / "results"
FILE, PICTURES = "overexposure.json", "overexposure.png"
DEEP = {"1 %": 0.01, "5 %": 0.05, "20 %": 0.2}
"""Share of the pixels whose brightest sample is twice the level that the frames are clipped at, and more."""
NEAR_CLIP = 0.98  # of the largest value: from here on samples count as clipped, as decode counts them
NOW = OlatParameters()
AS_THEY_ARE = "M = 0"
BOUND = "bounds"
WAYS: dict[str, dict[str, Any]] = {
    BOUND: {},
    AS_THEY_ARE: {"saturation": np.inf},
    **{f"M = {m}": {"remove": True, "removals": m, "gap": NOW.overexposure_gap} for m in (1, 2, 3, 4)},
    **{f"M = 2, epsilon {gap}": {"remove": True, "removals": 2, "gap": gap} for gap in (0.05, 0.2, 0.4)},
}
SHOWN = (BOUND, AS_THEY_ARE, "M = 1", "M = 2", "M = 4")


def main() -> None:
    """Measure and keep."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=RESULTS)
    parser.add_argument("--captures", type=Path, help="folder of captures; light stages with gt_brdf.json are clipped too")
    options = parser.parse_args()
    rows, pictures = [], []
    for name, pixels, inside in all_pixels(options.captures):
        for deep, share in DEEP.items():
            print(f"{name}, clipped {deep}", flush=True)
            made, maps = clipped(pixels, share)
            rows += [{"pixels": name, "deep": deep} | row for row in made]
            if inside is not None and deep == list(DEEP)[-1]:
                pictures.append(picture(pixels, inside, maps))
    for row in rows:
        print("  ".join(f"{k} {v if isinstance(v, str) else format(v, '.3g')}" for k, v in row.items()))
    options.out.mkdir(parents=True, exist_ok=True)
    (options.out / FILE).write_text(json.dumps({"rows": rows, "made": made_with(NOW)}, indent=1) + "\n")
    if pictures:
        wide = max(image.shape[1] for image in pictures)
        padded = [np.pad(image, ((0, 2), (0, wide - image.shape[1]), (0, 0)), constant_values=1.0) for image in pictures]
        write_png(options.out / PICTURES, np.concatenate(padded))


def all_pixels(folder: Path | None) -> Iterator[tuple[str, Pixels, NDArray[np.bool_] | None]]:
    """Synthetic pixels, then those of every light stage with ground truth in `folder` with where they lie [H, W]."""
    yield "synthetic", make(1000, lobe="beckmann", sigma=(0.15, 0.15), noise=1e-3, shadow=0.3, seed=5), None
    for name, (pixels, inside) in (captures(folder) if folder else {}).items():
        yield name, pixels, inside


def clipped(p: Pixels, share: float) -> tuple[list[dict[str, Any]], dict[str, NDArray]]:
    """A row for every way on pixels clipped so that `share` of them are twice over; and every way's results [P, WIDTH].

    The results of pixels without a clipped sample are there too.
    """
    brightest = p.parallel.max((0, 2))
    level = float(np.quantile(brightest, 1 - share)) / 2
    cross, parallel = (np.minimum(x, level).astype(np.float32) for x in (p.cross, p.parallel))
    hit = brightest > level
    out, maps = [], {}
    for way, change in WAYS.items():
        settings = SETTINGS._replace(**{"saturation": NEAR_CLIP * level} | change)
        load(half=False, precision="float32")
        started = time.process_time()
        maps[way], _ = fit(cross, parallel, p.view, p.rig, settings, threads=1)
        seconds = (time.process_time() - started) / len(hit)
        row = {"level": level, "clipped_pixels": float(hit.mean()), "way": way, "seconds_per_pixel": seconds}
        out.append(row | errors(maps[way][hit], p, hit))
    return out, maps


def errors(rows: NDArray, p: Pixels, hit: NDArray) -> dict[str, float]:
    """Medians over the pixels `hit` that are clipped: degrees and relative errors; and the mean share of light taken away."""
    removed = rows[:, AT["removed"]]
    found = {
        "n_d_deg": angle_deg(rows[:, AT["diffuse_normal"]], p.normal[hit]),
        "n_s_deg": angle_deg(rows[:, AT["specular_normal"]], p.normal[hit]),
        "rho_d_rel": np.abs(rows[:, AT["diffuse_albedo"]] / np.maximum(p.albedo[hit], 0.02) - 1),
        "rho_s_rel": np.abs(rows[:, AT["specular_albedo"]][:, 0] / p.specular[hit] - 1),
        "sigma_rel": np.abs(rows[:, AT["sigma"]] / p.sigma[hit] - 1),
    }
    return {name: float(np.median(values)) for name, values in found.items()} | {"removed": float(removed[:, 1].mean())}


def picture(p: Pixels, inside: NDArray, maps: dict[str, NDArray]) -> NDArray:
    """Specular albedo, diffuse albedo and ten times the removed share, of the ways `SHOWN` side by side [H, W, 3]; sRGB."""
    white = 2.0 * float(np.median(p.specular))
    columns = []
    for way in SHOWN:
        rows = maps[way]
        specular = np.repeat(rows[:, AT["specular_albedo"]] / white, 3, axis=1)
        removed = np.repeat(np.clip(10 * rows[:, AT["removed"]][:, 1:], 0, 1), 3, axis=1)
        for values in (specular, rows[:, AT["diffuse_albedo"]], removed):
            image = np.zeros((*inside.shape, 3))
            image[inside] = srgb_encode(np.clip(values, 0, 1))
            columns.append(image)
    order = [k * 3 + kind for kind in range(3) for k in range(len(SHOWN))]
    return np.concatenate([columns[k] for k in order], axis=1)


if __name__ == "__main__":
    main()
