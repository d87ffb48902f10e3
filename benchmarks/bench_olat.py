"""Speed and error of the olat fits: the whole chain, PRF's Table 3 rerun, printed forms, noise, few lights, large frames.

`make bench-olat [CAPTURES=folder]`; CAPTURES adds the light stages with ground truth found there to the tables of forms and of
noise. Parts run one by one (`--parts speed zoo`); results are kept in benchmarks/results/olat.json and pictures beside it.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import time
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import olat_forms, olat_frames, olat_noise, olat_plots, olat_zoo
from benchmarks.case_store import made_with, stamp
from benchmarks.olat_settings import AT, SETTINGS, timed
from pipeline.rig.lsx3_and_csv_light_tables import table_from_positions
from pipeline.rig.solid_angles import solid_angles
from stages.olat.parameters import OlatParameters
from stages.olat.pixel_fit.many_pixels import fit
from stages.olat.pixel_fit.result_layout import FLAG
from stages.olat.zoo.solvers import SOLVERS
from synth.olat_pixels import angle_deg, make, rig_of

RESULTS = Path(__file__).parent / "results"
PARTS = ("speed", "lights", "forms", "noise", "frames", "full", "zoo")


def throughput(count: int, lights: int = 346) -> dict[str, float]:
    """The whole chain on RGB pixels in memory (half floats), all threads: pixels a second."""
    p = make(count, rig=rig_of(lights), sigma=None, noise=5e-4, shadow=0.3, lobe="beckmann")
    cross, parallel = (np.ascontiguousarray(x.astype(np.float16)).view(np.uint16) for x in (p.cross, p.parallel))
    seconds, _ = timed(lambda: fit(cross, parallel, p.view, p.rig, SETTINGS))
    start = time.process_time()
    fit(cross, parallel, p.view, p.rig, SETTINGS)
    cpu = time.process_time() - start
    return {
        "pixels": count, "lights": lights, "threads": os.cpu_count() or 1, "pixels_per_s": count / seconds,
        "pixels_per_cpu_s": count / cpu, "load": os.getloadavg()[0],
        "peak_rss_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
    }  # fmt: skip


def against_lights(steps: tuple[int, ...] = (1, 2, 4, 8, 16, 32)) -> list[dict[str, float]]:
    """Median errors with each k-th light of 346."""
    out = []
    for step in steps:
        rig = table_from_positions(rig_of().positions[::step])
        rig = type(rig)(rig.directions, rig.positions, rig.intensity, solid_angles(rig.directions))
        p = make(800, rig=rig, lobe="beckmann", sigma=(0.3, 0.2), noise=1e-3, shadow=0.3)
        rows, _ = fit(p.cross.astype(np.float32), p.parallel.astype(np.float32), p.view, p.rig, SETTINGS)
        row = {"lights": len(rig), "flagged": float(np.mean(rows[:, FLAG] != 0))}
        for name, key in (("n_d", "diffuse_normal"), ("n_s", "specular_normal")):
            row[f"{name}_deg"] = float(np.median(angle_deg(rows[:, AT[key]], p.normal)))
        row["sigma_rel"] = float(np.median(np.abs(rows[:, AT["sigma"]] / p.sigma - 1)))
        row["rho_d_rel"] = float(np.median(np.abs(rows[:, AT["diffuse_albedo"]] / p.albedo - 1)))
        out.append(row)
        print("  " + "  ".join(f"{k} {v:.3g}" for k, v in row.items()), flush=True)
    return out


def main() -> None:
    """Run the parts and keep what they found."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--captures", type=Path, help="folder of captures; light stages with gt_brdf.json enter the tables")
    parser.add_argument("--parts", nargs="*", choices=PARTS, default=list(PARTS), help="what to run")
    parser.add_argument("--pixels", type=int, default=4000, help="pixels of the throughput run")
    parser.add_argument("--zoo-pixels", type=int, default=256, help="pixels of the solver comparison")
    parser.add_argument("--solvers", nargs="*", choices=SOLVERS, default=list(SOLVERS), help="solvers to compare")
    options = parser.parse_args()
    RESULTS.mkdir(exist_ok=True)
    kept = RESULTS / "olat.json"
    record: dict[str, Any] = json.loads(kept.read_text()) if kept.is_file() else {}
    begin = time.perf_counter()
    for part in options.parts:
        print(f"{part}:", flush=True)
        start = time.perf_counter()
        if part == "speed":
            record["speed"] = throughput(options.pixels)
            print("  " + "  ".join(f"{k} {v:.4g}" for k, v in record["speed"].items()), flush=True)
        elif part == "lights":
            record["lights"] = against_lights()
            olat_plots.plot_lights(record["lights"], RESULTS / "olat_lights.png")
        elif part == "forms":
            record["forms"] = olat_forms.table("synthetic", olat_forms.synthetic())
            for name, (pixels, _) in olat_forms.captures(options.captures).items() if options.captures else ():
                record["forms"] += olat_forms.table(name, pixels)
        elif part == "noise" and options.captures:
            record["noise"] = olat_noise.table(options.captures)
        elif part == "noise":
            print("  no --captures given")
        elif part == "frames":
            record["frames"] = olat_frames.large_frames(options.captures)
        elif part == "full":
            record["full"] = {**olat_frames.full_size(), **stamp()}
        else:
            pixels = make(options.zoo_pixels, sigma=(0.3, 0.2), noise=1e-3, seed=3)
            record["ours"] = {q: asdict(c) for q, c in olat_zoo.table_ours(pixels).items()}
            theirs = olat_zoo.table_theirs(pixels, tuple(options.solvers))
            record["theirs"] = {s: {q: asdict(c) for q, c in cells.items()} for s, cells in theirs.items()}
            record["published"] = olat_zoo.PUBLISHED
            olat_plots.plot_solvers(record, RESULTS / "olat_solvers.png")
        if part == PARTS[-1] and set(options.parts) == set(PARTS):  # else some of it is from before
            record["made"] = made_with(OlatParameters())
        kept.write_text(json.dumps(record, indent=1) + "\n")
        print(f"  {part} took {time.perf_counter() - start:.0f} s", flush=True)
    print(f"kept in {RESULTS}, {time.perf_counter() - begin:.0f} s in all")


if __name__ == "__main__":
    main()
