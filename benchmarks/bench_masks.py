"""Masks: IoU with the truth against processor time, for every method on captures whose masks are known.

usage: python benchmarks/bench_masks.py [--captures DIR] [--only NAME ...] [--out benchmarks/results]

Captures: DIR/homer-messy (forest behind the object) is segmented as it is; DIR/teapot-lebombo and DIR/spot-venice get
a background first: a photograph-like environment map of their own, seen along each pixel's ray behind the true mask.
DIR/ls-spot has mattes to hold the one from the sum of its lights against.
"""

from __future__ import annotations

import argparse
import io
import json
import os
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

from benchmarks.case_store import made_with
from pipeline.capture import Capture, open_capture
from pipeline.engine.progress import Progress
from pipeline.engine.stage import StageRun
from pipeline.formats.images import read_image, read_mask
from pipeline.geometry.cameras import Camera
from stages.masks.background import segment
from stages.masks.clean_plate import difference_mask
from stages.masks.grabcut import grabcut_centre
from stages.masks.matte import light_stage_matte
from stages.masks.parameters import MasksParameters

CAPTURES = ("homer-messy", "teapot-lebombo", "spot-venice", "ls-spot")
LIGHT_STAGE = "ls-spot"
Scene = tuple[list[np.ndarray], list[np.ndarray], list[np.ndarray], list[Camera]]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--captures", type=Path, default=os.environ.get("POLARFIELD_CAPTURES"), required=False)
    parser.add_argument("--out", type=Path, default=Path(__file__).parent / "results")
    parser.add_argument("--only", nargs="*", help="captures to measure now; the others' rows are kept")
    options = parser.parse_args()
    if options.captures is None:
        parser.error("give --captures or POLARFIELD_CAPTURES")
    path = options.out / "masks.json"
    rows: list[dict] = json.loads(path.read_text()) if path.is_file() else []
    options.out.mkdir(parents=True, exist_ok=True)
    for name in options.only or CAPTURES:
        root = Path(options.captures) / name
        new = light_stage_rows(root) if name == LIGHT_STAGE else multiview_rows(root)
        rows = [row for row in rows if row["capture"] != name] + new
        path.write_text(json.dumps(rows, indent=1) + "\n")
        print(json.dumps(new, indent=1), flush=True)
    figure(rows, options.out / "masks_error.png")


def multiview_rows(root: Path) -> list[dict]:
    """A row a method."""
    rows = []
    images, truth, plates, cameras = load(root)
    methods: dict[str, Callable[[], list[np.ndarray] | None]] = {
        "all views together": lambda: segment(images, cameras, {}, 480),
        "all views, half size": lambda: segment(images, cameras, {}, max(images[0].shape) // 2),
        "GrabCut, each view": lambda: [grabcut_centre(image) for image in images],
    }
    if plates:
        methods["clean plate"] = lambda: [difference_mask(a, b) for a, b in zip(images, plates)]
    segment(images[:4], cameras[:4], {}, 64)  # compiled before it is timed
    for method, run in methods.items():
        start = time.process_time()
        masks = run() or []
        rows.append(scored(root.name, method, masks, truth, time.process_time() - start))
    return rows


def light_stage_rows(root: Path) -> list[dict]:
    """The matte from the sum of all lights, against the mattes that were rendered."""
    capture = open_capture(root)
    assert capture.light_stage is not None
    cameras = [c for c in capture.light_stage.cameras.values() if c.mask is not None]
    run = StageRun(capture, MasksParameters(), {}, root, root, progress=Progress(io.StringIO()), jobs=2)
    start = time.process_time()
    masks = [light_stage_matte(camera, run) > 127 for camera in cameras]
    seconds = time.process_time() - start
    return [scored(root.name, "matte", masks, [read_mask(c.mask) for c in cameras if c.mask is not None], seconds)]


def scored(capture: str, method: str, masks: list[np.ndarray], truth: list[np.ndarray], seconds: float) -> dict:
    scores = [iou(m, t) for m, t in zip(masks, truth)]
    row = {
        "made": made_with(MasksParameters()),
        "capture": capture,
        "method": method,
        "iou_mean": float(np.mean(scores)),
        "iou_min": float(np.min(scores)),
    }
    return {**row, "s_per_view": seconds / len(truth)}


def iou(a: np.ndarray, b: np.ndarray) -> float:
    return float((a & b).sum() / max(1, (a | b).sum()))


def load(root: Path) -> Scene:
    """(images, true masks, clean plates or none, cameras) of a capture."""
    capture = open_capture(root)
    images = [np.maximum(v.read().s0, 0) for v in capture.views]
    cameras = [capture.cameras[v.view] for v in capture.views]  # type: ignore[index]
    if not isinstance(capture.masks, dict):
        return images, [read_mask(root / "gt" / "mask" / f"{v.view}.png") for v in capture.views], [], cameras
    truth = [read_mask(capture.masks[v.view]) for v in capture.views]
    rng = np.random.default_rng(0)
    behind = [background(capture, camera) for camera in cameras]
    noisy = [b + rng.normal(0, 5e-4, b.shape).astype(np.float32) for b in behind]
    plates = [np.maximum(b + rng.normal(0, 5e-4, b.shape).astype(np.float32), 0) for b in behind]
    composed = [np.where(m[..., None], i, b) for i, m, b in zip(images, truth, noisy)]
    return [np.maximum(c, 0).astype(np.float32) for c in composed], truth, plates, cameras


def background(capture: Capture, camera: Camera) -> np.ndarray:
    """The capture's own environment along every ray, y up, [H, W, 3]."""
    map_ = read_image(capture.root / "gt" / "env.hdr")[..., :3]
    x, y, z = np.moveaxis(camera.rays(), -1, 0)
    column = (np.arctan2(x, -z) / (2 * np.pi) % 1 * map_.shape[1]).astype(int) % map_.shape[1]
    row = np.minimum((np.arccos(np.clip(y, -1, 1)) / np.pi * map_.shape[0]).astype(int), map_.shape[0] - 1)
    return map_[row, column]


def figure(rows: list[dict], path: Path) -> None:
    """1 - IoU against processor seconds a view, one mark a method and capture."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    fig, axes = plt.subplots(figsize=(7, 4.5))
    captures, methods = (list(dict.fromkeys(row[key] for row in rows)) for key in ("capture", "method"))
    for row in rows:
        colour, marker = f"C{methods.index(row['method'])}", "osD^v"[captures.index(row["capture"])]
        axes.loglog(row["s_per_view"], max(1e-4, 1 - row["iou_mean"]), marker, color=colour)
    for method in methods:
        axes.plot([], [], "o", color=f"C{methods.index(method)}", label=method)
    for capture in captures:
        axes.plot([], [], "osD^v"[captures.index(capture)], color="grey", label=capture)
    axes.axhline(0.05, color="black", linewidth=0.8, linestyle="--", label="IoU 0.95")
    axes.set(xlabel="processor time (s a view)", ylabel="1 - mean IoU", title="Mask methods")
    axes.xaxis.set_minor_formatter("")  # they would run into each other
    axes.grid(True, which="both", alpha=0.3)
    axes.legend(fontsize=7, ncols=2)
    fig.tight_layout()
    fig.savefig(path, dpi=120, metadata={"Software": ""})


if __name__ == "__main__":
    main()
