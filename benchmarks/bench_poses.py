"""Poses: registered views, reprojection error, focal length and run time on a folder of photographs.

usage: python benchmarks/bench_poses.py PHOTOGRAPHS [--focal TRUE_PX] [--plain] [--out benchmarks/results]

Runs decode and poses twice (the cameras must be the same bit for bit); --plain also runs pycolmap with its defaults on the
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
from pipeline.capture import open_capture
from pipeline.capture.files import image_folder
from pipeline.stage import StageRun

PLAIN_SIZE = 1600


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("photographs", type=Path)
    parser.add_argument("--focal", type=float)
    parser.add_argument("--plain", action="store_true")
    parser.add_argument("--out", type=Path, default=Path(__file__).parent / "results")
    options = parser.parse_args()
    runs = [ours(options.photographs) for _ in range(2)]
    result: dict[str, Any] = {"ours": runs[0], "same_twice": runs[0]["digest"] == runs[1]["digest"]}
    if options.plain:
        result["plain"] = plain(options.photographs)
    for row in (result["ours"], result.get("plain")):
        if row and options.focal:
            row["focal_error_pct"] = [100 * abs(f / options.focal - 1) for f in row["focal_px"]]
    options.out.mkdir(parents=True, exist_ok=True)
    (options.out / "poses.json").write_text(json.dumps(result, indent=1) + "\n")
    print(json.dumps(result, indent=1))


def ours(root: Path) -> dict[str, Any]:
    """Our stages on a capture folder."""
    capture = open_capture(root)
    with tempfile.TemporaryDirectory() as temporary:
        inputs, seconds, run = {}, {}, None
        for stage in (decode.STAGE, poses.STAGE):
            output, scratch = Path(temporary, stage.name), Path(temporary, f"{stage.name}.scratch")
            output.mkdir()
            scratch.mkdir()
            run = StageRun(capture, stage.parameters(), dict(inputs), output, scratch, jobs=2)
            start = time.perf_counter()
            stage.run(run)
            seconds[stage.name] = time.perf_counter() - start
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
