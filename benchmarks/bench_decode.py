"""Decode: speed of 12-megapixel frames, and error against run time of every way to a Stokes image.

usage: python benchmarks/bench_decode.py [--captures DIR] [--megapixels 12] [--no-speed] [--out benchmarks/results]

Speed: frames of each kind are written once, then read and converted to Stokes by two threads (Mpx/s), and the whole
decode stage is held against writing the same EXR files alone. Error: mosaics and stacks are made from captures with
known Stokes vectors (DIR/teapot-lebombo, DIR/spot-venice, with sensor noise) and solved by each method.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

from pipeline.capture import open_capture
from pipeline.capture.mosaic import demosaic
from pipeline.capture.stack import polariser_design, solve_stack
from pipeline.images import read_mask, read_stokes, write_stokes
from pipeline.stage import StageRun

ORDER = (90.0, 45.0, 135.0, 0.0)
NOISE = 5e-4


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--captures", type=Path, default=os.environ.get("POLARFIELD_CAPTURES"))
    parser.add_argument("--megapixels", type=float, default=12.0)
    parser.add_argument("--frames", type=int, default=4)
    parser.add_argument("--out", type=Path, default=Path(__file__).parent / "results")
    parser.add_argument("--no-speed", action="store_true", help="errors alone")
    options = parser.parse_args()
    result: dict = {} if options.no_speed else {"speed": speed(options.megapixels, options.frames)}
    if options.captures:
        result["error"] = errors(Path(options.captures))
        figure(result["error"], options.out / "decode_error.png")
    options.out.mkdir(parents=True, exist_ok=True)
    (options.out / "decode.json").write_text(json.dumps(result, indent=1) + "\n")
    print(json.dumps(result, indent=1))


def big_stokes(megapixels: float) -> np.ndarray:
    """A noisy, textured Stokes image of a 4:3 sensor, sides multiples of 4."""
    width = int(np.sqrt(megapixels * 1e6 * 4 / 3)) // 4 * 4
    height = width * 3 // 16 * 4
    rng = np.random.default_rng(0)
    y, x = np.mgrid[:height, :width].astype(np.float32) / 100
    s0 = (
        0.4
        + 0.2 * np.sin(x)[..., None] * np.cos(y)[..., None] * np.float32([1, 0.8, 0.6])
        + rng.normal(0, 0.01, (height, width, 3))
    )
    return np.stack([s0, 0.2 * s0 * np.cos(x)[..., None], 0.2 * s0 * np.sin(y)[..., None]], 2).astype(np.float32)


def write_kinds(root: Path, stokes: np.ndarray, frames: int) -> dict[str, Path]:
    """One capture folder per kind of frame."""
    import tifffile

    height, width = stokes.shape[:2]
    rows = polariser_design(ORDER).reshape(2, 2, 3)
    mosaic = np.empty((height, width), np.float32)
    for j in range(2):
        for i in range(2):
            mosaic[j::2, i::2] = stokes[j::2, i::2].mean(-1) @ rows[j, i]
    codes = np.round(np.clip(mosaic, 0, 1) * 65535).astype(np.uint16)
    kinds = {kind: root / kind for kind in ("stokes_exr", "mosaic_tiff", "stack_tiff")}
    for k in range(frames):
        write_stokes(kinds["stokes_exr"] / "images" / f"{k}.exr", stokes, half=True)
        (kinds["mosaic_tiff"] / "images").mkdir(parents=True, exist_ok=True)
        tifffile.imwrite(kinds["mosaic_tiff"] / "images" / f"{k}.tif", codes, photometric="minisblack")
    for k in range(max(1, frames // 2)):
        (kinds["stack_tiff"] / "images").mkdir(parents=True, exist_ok=True)
        for angle in (0, 45, 90, 135):
            intensity = np.einsum("k,hwkc->hwc", polariser_design([angle])[0], stokes)
            image = np.round(np.clip(intensity, 0, 1) * 65535).astype(np.uint16)
            tifffile.imwrite(kinds["stack_tiff"] / "images" / f"v{k}_{angle:03d}.tif", image, photometric="rgb")
    return kinds


def speed(megapixels: float, frames: int) -> dict[str, dict[str, float]]:
    """Reading and conversion (Mpx/s), and the decode stage over writing alone, per kind of frame."""
    import stages.calib.decode.stage as decode

    out = {}
    stokes = big_stokes(megapixels)
    size = stokes.shape[0] * stokes.shape[1] / 1e6
    with tempfile.TemporaryDirectory() as temporary:
        for kind, root in write_kinds(Path(temporary), stokes, frames).items():
            capture = open_capture(root)
            capture.views[0].read()  # the page cache and lazy imports are not what is timed

            def read(view) -> None:
                view.read()

            best = np.inf
            for _ in range(3):
                start = time.perf_counter()
                with ThreadPoolExecutor(2) as pool:
                    list(pool.map(read, capture.views))
                best = min(best, time.perf_counter() - start)
            write = min(write_alone(root / f"w{attempt}", stokes, len(capture.views)) for attempt in range(2))
            whole = np.inf
            for attempt in range(2):
                output, scratch = root / f"out{attempt}", root / f"scratch{attempt}"
                output.mkdir()
                scratch.mkdir()
                start = time.perf_counter()
                decode.STAGE.run(StageRun(capture, decode.DecodeParameters(), {}, output, scratch, jobs=2))
                whole = min(whole, time.perf_counter() - start)
            out[kind] = {
                "read_and_convert_mpx_per_s": len(capture.views) * size / best,
                "decode_s": whole, "write_alone_s": write, "decode_over_write": whole / write,
            }  # fmt: skip
    return out


def write_alone(folder: Path, stokes: np.ndarray, count: int) -> float:
    """Seconds to write `count` frames with two threads and nothing else."""
    start = time.perf_counter()
    with ThreadPoolExecutor(2) as pool:
        list(pool.map(lambda k: write_stokes(folder / f"{k}.exr", stokes, half=True), range(count)))
    return time.perf_counter() - start


def mosaic_of(stokes: np.ndarray, colour: str) -> np.ndarray:
    """An ideal sensor's samples of a Stokes image, with noise."""
    y, x = np.mgrid[: stokes.shape[0], : stokes.shape[1]]
    rows = polariser_design(ORDER).reshape(2, 2, 3)[y % 2, x % 2]
    intensity = np.einsum("hwk,hwkc->hwc", rows, stokes)
    if colour == "mono":
        samples = intensity.mean(-1)
    else:
        channel = np.array([[0, 1], [1, 2]])[(y // 2) % 2, (x // 2) % 2]
        samples = np.take_along_axis(intensity, channel[..., None], -1)[..., 0]
    return (samples + np.random.default_rng(0).normal(0, NOISE, samples.shape)).astype(np.float32)


def dolp(stokes: np.ndarray) -> np.ndarray:
    return np.minimum(np.hypot(stokes[:, :, 1], stokes[:, :, 2]) / np.maximum(stokes[:, :, 0], 1e-6), 1)


def errors(captures: Path) -> dict[str, dict[str, float]]:
    """RMS error of DoLP inside the mask and run time per megapixel of each method."""
    samples = []
    for name in ("teapot-lebombo", "spot-venice"):
        capture = open_capture(captures / name)
        masks = capture.masks if isinstance(capture.masks, dict) else {}
        samples += [(read_stokes(v.paths[0]), read_mask(masks[v.view])) for v in capture.views[::6]]
    out: dict[str, dict[str, float]] = {}

    def score(method: str, solve, truth_of) -> None:
        squared, count, seconds, pixels = 0.0, 0, 0.0, 0
        for stokes, mask in samples:
            truth = truth_of(stokes)
            start = time.perf_counter()
            found = solve(stokes)
            seconds += time.perf_counter() - start
            lit = mask & (truth[:, :, 0].min(-1) > 0.005)
            squared += float(((dolp(found) - dolp(truth))[lit] ** 2).sum())
            count += int(lit.sum()) * 3
            pixels += mask.size
        out[method] = {"dolp_rmse": float(np.sqrt(squared / count)), "s_per_mpx": seconds / pixels * 1e6}

    for colour in ("mono", "bayer"):
        for method in ("bilinear", "residual"):
            score(
                f"mosaic {colour} {method}",
                lambda s, c=colour, m=method: demosaic(mosaic_of(s, c), ORDER, c, method=m),
                (lambda s: np.repeat(s.mean(-1, keepdims=True), 3, -1)) if colour == "mono" else (lambda s: s),
            )
    for angles in ((0, 45, 90), (0, 60, 120), (0, 45, 90, 135), (0, 30, 60, 90, 120, 150)):
        design = polariser_design(angles)

        def solve(s, d=design):
            rng = np.random.default_rng(0)
            images = np.einsum("nk,hwkc->nhwc", d, s)
            return solve_stack((images + rng.normal(0, NOISE, images.shape)).astype(np.float32), d)[0]

        score(f"stack {' '.join(map(str, angles))}", solve, lambda s: s)
    return out


def figure(rows: dict[str, dict[str, float]], path: Path) -> None:
    """Error against run time, one mark a method."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    path.parent.mkdir(parents=True, exist_ok=True)
    fig, axes = plt.subplots(figsize=(7, 4.5))
    for name, row in rows.items():
        axes.loglog(row["s_per_mpx"], row["dolp_rmse"], "o" if name.startswith("mosaic") else "s", label=name)
    axes.set(xlabel="run time (s per megapixel, samples made included)", ylabel="RMS error of DoLP", title="Decode methods")
    axes.grid(True, which="both", alpha=0.3)
    axes.legend(fontsize=7)
    fig.tight_layout()
    fig.savefig(path, dpi=120, metadata={"Software": ""})


if __name__ == "__main__":
    main()
