"""Poses: registered views, reprojection error, focal length and run time on a folder of photographs.

usage: python benchmarks/bench_poses.py PHOTOGRAPHS [--focal TRUE_PX] [--sizes 1000] [--plain] [--more] [--out DIR]

Runs decode and poses twice (the cameras must be the same bit for bit) and once for each other size of pictures;
--plain also runs pycolmap with its defaults on the
photographs as they are, at the same size of pictures.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parents[1]))

import pipeline  # noqa: F401 - loads zlib before pycolmap does
import stages.calib.decode.stage as decode
import stages.calib.poses.stage as poses
from benchmarks.case_store import made_with
from pipeline.capture import open_capture
from pipeline.capture.naming.files import image_folder
from pipeline.engine.stage import StageRun
from stages.calib.poses.parameters import PosesParameters

PLAIN_SIZE = 1600


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("photographs", type=Path)
    parser.add_argument("--focal", type=float)
    parser.add_argument("--plain", action="store_true")
    parser.add_argument("--sizes", type=int, nargs="*", default=[], help="other longer sides at which features are found")
    parser.add_argument("--more", action="store_true", help="keep what the results file holds, run only --sizes and --plain")
    parser.add_argument("--out", type=Path, default=Path(__file__).parent / "results")
    options = parser.parse_args()
    path = options.out / "poses.json"
    result: dict[str, Any] = json.loads(path.read_text()) if options.more else {}
    result.pop("made", None)
    if not options.more:
        runs = [ours(options.photographs) for _ in range(2)]
        result = {"ours": runs[0], "same_twice": runs[0]["digest"] == runs[1]["digest"]}
    for size in options.sizes:
        result[f"ours at {size} px"] = ours(options.photographs, size)
    if options.plain:
        result["plain"] = plain(options.photographs)
    for row in result.values():
        if isinstance(row, dict) and options.focal:
            row["focal_error_pct"] = [100 * abs(f / options.focal - 1) for f in row["focal_px"]]
    options.out.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps({**result, "made": made_with(PosesParameters())}, indent=1) + "\n")
    print(json.dumps(result, indent=1))
    figure(result, options.out / "poses_error.png")


def figure(result: dict[str, Any], path: Path) -> None:
    """Focal length's and reprojection error against run time."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    fig, both = plt.subplots(1, 2, figsize=(9, 4))
    for name, row in result.items():
        if isinstance(row, dict):
            label = f"{name}, {row['registered']} registered"
            seconds = row.get("poses_cpu_s", row["poses_s"])  # other programs' share of the machine left out
            both[0].plot(seconds, row["reprojection_error_px"], "o", label=label)
            both[1].plot(seconds, max(row.get("focal_error_pct", [float("nan")])), "o", label=label)
    both[0].axhline(0.7, color="black", linewidth=0.8, linestyle="--")
    both[1].axhline(3.0, color="black", linewidth=0.8, linestyle="--")
    both[0].set(ylabel="mean reprojection error (px)", ylim=(0, None))
    both[1].set(ylabel="focal length error (%)", ylim=(0, None))
    for axes in both:
        axes.set(xlabel="run time of poses (CPU s, two cores)")
        axes.set_xlim(0, 1.1 * axes.get_xlim()[1])
        axes.grid(True, alpha=0.3)
        axes.legend(fontsize=8)
    fig.tight_layout()
    fig.savefig(path, dpi=120, metadata={"Software": ""})


def ours(root: Path, size: int | None = None) -> dict[str, Any]:
    """Our stages on a capture folder."""
    capture = open_capture(root)
    with tempfile.TemporaryDirectory() as temporary:
        inputs: dict[str, Path] = {}
        seconds, run = {}, None
        for stage in (decode.STAGE, poses.STAGE):
            output, scratch = Path(temporary, stage.name), Path(temporary, f"{stage.name}.scratch")
            output.mkdir()
            scratch.mkdir()
            chosen = stage.parameters(max_size=size) if size and stage is poses.STAGE else stage.parameters()
            run = StageRun(capture, chosen, dict(inputs), output, scratch, jobs=2)
            start, cpu = time.perf_counter(), time.process_time()
            stage.run(run)
            seconds[stage.name] = time.perf_counter() - start
            seconds[f"{stage.name} cpu"] = time.process_time() - cpu
            inputs[stage.name] = output
        assert run is not None
        digest = hashlib.sha256((run.output / "cameras.json").read_bytes()).hexdigest()
        facts = run.facts
    return {
        "views": facts["views"],
        "registered": facts["registered"],
        "reprojection_error_px": facts["mean_reprojection_error_px"],
        "focal_px": list(facts["focal_px"].values()),
        "decode_s": seconds["decode"],
        "poses_s": seconds["poses"],
        "poses_cpu_s": seconds["poses cpu"],
        "digest": digest,
    }


def plain(root: Path) -> dict[str, Any]:
    """pycolmap as it comes, CPU, at PLAIN_SIZE."""
    import pycolmap

    images = image_folder(root)
    with tempfile.TemporaryDirectory() as temporary:
        database, start = Path(temporary, "database.db"), time.perf_counter()
        options = pycolmap.FeatureExtractionOptions(use_gpu=False)
        options.max_image_size = PLAIN_SIZE
        pycolmap.extract_features(database, images, extraction_options=options)
        pycolmap.match_exhaustive(database, matching_options=pycolmap.FeatureMatchingOptions(use_gpu=False))
        Path(temporary, "sparse").mkdir()
        models = pycolmap.incremental_mapping(database, images, Path(temporary, "sparse"))
        seconds = time.perf_counter() - start
        best = max(models.values(), key=lambda m: m.num_reg_images())
        focal = [float(c.params[0]) for c in best.cameras.values()]
        error = float(best.compute_mean_reprojection_error())
    return {"registered": best.num_reg_images(), "reprojection_error_px": error, "focal_px": focal, "poses_s": seconds}


if __name__ == "__main__":
    main()
