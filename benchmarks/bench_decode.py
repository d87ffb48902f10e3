"""Decode: speed of 12-megapixel frames, and error against run time of every way to a Stokes image.

usage: python benchmarks/bench_decode.py [--captures DIR] [--megapixels 12] [--no-speed | --no-error] [--out benchmarks/results]

Speed: frames of each kind are written once, then read and converted to Stokes by two threads (Mpx/s), and the whole
decode stage is held against writing the same EXR files alone. Error: mosaics and stacks are made from captures with
known Stokes vectors (DIR/teapot-lebombo, DIR/spot-venice, with sensor noise) and solved by each method.
"""

from __future__ import annotations

import argparse
import io
import json
import os
import resource
import shutil
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Callable, Iterable
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

from benchmarks.case_store import made_with
from pipeline.capture import Capture, open_capture
from pipeline.capture.angle_stack.solve import polariser_design, solve_stack
from pipeline.capture.mosaic.demosaic import demosaic
from pipeline.engine.progress import Progress
from pipeline.engine.stage import StageRun
from pipeline.formats.images import read_mask, read_stokes, write_stokes
from pipeline.optics.stokes import degree
from stages.calib.decode.parameters import DecodeParameters

ORDER = (90.0, 45.0, 135.0, 0.0)
NOISE = 5e-4
ROUNDS, READINGS = 2, 4
"""Of everything, and of reading in each: it is short, and the best of several is what a quiet machine does."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--captures", type=Path, default=os.environ.get("POLARFIELD_CAPTURES"))
    parser.add_argument("--megapixels", type=float, default=12.0)
    parser.add_argument("--frames", type=int, default=4)
    parser.add_argument("--out", type=Path, default=Path(__file__).parent / "results")
    parser.add_argument("--no-speed", action="store_true", help="errors alone")
    parser.add_argument("--no-error", action="store_true", help="speed alone")
    options = parser.parse_args()
    captures = Path(options.captures) if options.captures else None
    path = options.out / "decode.json"
    result: dict = json.loads(path.read_text()) if path.is_file() else {}
    if not options.no_speed:
        result["speed"] = speed(options.megapixels, options.frames, captures)
    if captures is not None and not options.no_error:
        result["error"] = errors(captures)
        figure(result["error"], options.out / "decode_error.png")
    options.out.mkdir(parents=True, exist_ok=True)
    result["made"] = made_with(DecodeParameters())
    path.write_text(json.dumps(result, indent=1) + "\n")
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

    kinds = {kind: root / kind for kind in ("stokes_exr", "mosaic_tiff", "quad_bayer_tiff", "stack_tiff")}
    for k in range(frames):
        write_stokes(kinds["stokes_exr"] / "images" / f"{k}.exr", stokes, half=True)
    for kind, colour in (("mosaic_tiff", "mono"), ("quad_bayer_tiff", "bayer")):
        codes = np.round(np.clip(mosaic_of(stokes, colour), 0, 1) * 65535).astype(np.uint16)
        (kinds[kind] / "images").mkdir(parents=True, exist_ok=True)
        (kinds[kind] / "capture.toml").write_text(f'[mosaic]\ncolour = "{colour}"\n')
        for k in range(frames):
            tifffile.imwrite(kinds[kind] / "images" / f"{k}.tif", codes, photometric="minisblack")
    for k in range(max(2, frames // 2)):
        (kinds["stack_tiff"] / "images").mkdir(parents=True, exist_ok=True)
        for angle in (0, 45, 90, 135):
            intensity = np.einsum("k,hwkc->hwc", polariser_design([angle])[0], stokes)
            image = np.round(np.clip(intensity, 0, 1) * 65535).astype(np.uint16)
            tifffile.imwrite(kinds["stack_tiff"] / "images" / f"v{k}_{angle:03d}.tif", image, photometric="rgb")
    return kinds


def speed(megapixels: float, frames: int, captures: Path | None) -> dict[str, dict[str, float]]:
    """Reading and conversion (Mpx/s), and the decode stage over writing alone, per kind of frame, each in its own process."""
    out = {}
    with tempfile.TemporaryDirectory() as temporary:
        stokes = big_stokes(megapixels)
        kinds = write_kinds(Path(temporary), stokes, frames)
        if captures is not None:
            kinds["stokes_exr_render"] = write_render(Path(temporary), stokes.shape[:2], frames, captures)
        for kind, root in kinds.items():
            with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as process:  # for its own peak of memory
                out[kind] = process.submit(speed_of, root).result()
            print(json.dumps({kind: out[kind]}), flush=True)
            shutil.rmtree(root)
    return out


def speed_of(root: Path) -> dict[str, float]:
    """The figures of one capture. Rounds alternate, so that both sides of a ratio see the same machine."""
    capture = open_capture(root)
    first = capture.views[0].read().stokes  # the page cache and lazy imports are not what is timed
    assert first is not None
    size = first.shape[0] * first.shape[1] / 1e6 * len(capture.views)
    reading: list[tuple[float, float]] = []
    writing: list[tuple[float, float]] = []
    whole: list[tuple[float, float]] = []
    for _ in range(ROUNDS):
        for _ in range(READINGS):
            reading.append(timed(lambda: two_threads(lambda view: view.read() and None, capture.views)))
        writing.append(write_alone(capture))
        whole.append(decode_alone(capture))
    best = {name: np.min(rounds, axis=0) for name, rounds in (("read", reading), ("write", writing), ("whole", whole))}
    return {
        "read_and_convert_mpx_per_s": size / best["read"][0],
        "read_and_convert_mpx_per_cpu_s_x2": 2 * size / best["read"][1],
        "decode_s": best["whole"][0],
        "write_alone_s": best["write"][0],
        "decode_over_write": best["whole"][0] / best["write"][0],
        "decode_over_write_cpu": best["whole"][1] / best["write"][1],
        "peak_rss_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
        "frame_mb": first.nbytes / 1e6,
        "load_average": os.getloadavg()[0],  # above 2 on two cores: other jobs took part of the wall time
    }


def write_alone(capture: Capture) -> tuple[float, float]:
    """Seconds to write as many frames with two threads and nothing else."""
    stokes = capture.views[0].read().stokes
    assert stokes is not None
    with tempfile.TemporaryDirectory(dir=capture.root) as folder:
        return timed(lambda: two_threads(lambda v: write_stokes(Path(folder, f"{v.view}.exr"), stokes, True), capture.views))


def decode_alone(capture: Capture) -> tuple[float, float]:
    """Seconds of the whole decode stage."""
    import stages.calib.decode.stage as decode

    with tempfile.TemporaryDirectory(dir=capture.root) as folder:
        output, scratch = Path(folder, "out"), Path(folder, "scratch")
        output.mkdir()
        scratch.mkdir()
        run = StageRun(capture, decode.DecodeParameters(), {}, output, scratch, progress=Progress(io.StringIO()), jobs=2)
        return timed(lambda: decode.STAGE.run(run))


def timed(work: Callable[[], object]) -> tuple[float, float]:
    """(wall, CPU) seconds."""
    start, cpu = time.perf_counter(), time.process_time()
    work()
    return time.perf_counter() - start, time.process_time() - cpu


def two_threads(work: Callable[[Any], object], items: Iterable[Any]) -> None:
    with ThreadPoolExecutor(2) as pool:
        list(pool.map(work, items))


def write_render(root: Path, shape: tuple[int, int], frames: int, captures: Path) -> Path:
    """Renders of an object before black, repeated to the size of a large frame: easier to pack than noise."""
    views = open_capture(captures / "spot-venice").views
    for k in range(frames):
        tile = read_stokes(views[k].paths[0])
        count = [-(-n // m) for n, m in zip(shape, tile.shape)]
        write_stokes(root / "render" / "images" / f"{k}.exr", np.tile(tile, (*count, 1, 1))[: shape[0], : shape[1]], half=True)
    return root / "render"


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
    """DoLP [H, W, C], at most 1, of Stokes images [H, W, 3, C]."""
    return np.minimum(degree(np.moveaxis(stokes, 2, -1)), 1)


def errors(captures: Path) -> dict[str, dict[str, float]]:
    """RMS error of DoLP inside the mask, pooled and by capture, and run time per megapixel of each method."""
    samples: list[tuple[str, np.ndarray, np.ndarray]] = []
    for name in ("teapot-lebombo", "spot-venice"):
        capture = open_capture(captures / name)
        masks = capture.masks if isinstance(capture.masks, dict) else {}
        samples += [(name, read_stokes(v.paths[0]), read_mask(masks[v.view])) for v in capture.views[::6]]
    out: dict[str, dict[str, float]] = {}

    def score(method: str, make, solve, truth_of) -> None:
        squared: dict[str, float] = defaultdict(float)
        count: dict[str, int] = defaultdict(int)
        seconds, pixels = 0.0, 0
        for name, stokes, mask in samples:
            truth, measured = truth_of(stokes), make(stokes)
            found = solve(measured)  # compiled and cached before it is timed
            start = time.process_time()  # the frames are small: one thread, and no other process counts
            solve(measured)
            seconds += time.process_time() - start
            lit = mask & (truth[:, :, 0].min(-1) > 0.005)
            squared[name] += float(((dolp(found) - dolp(truth))[lit] ** 2).sum())
            count[name] += int(lit.sum()) * 3
            pixels += mask.size
        pooled = float(np.sqrt(sum(squared.values()) / sum(count.values())))
        out[method] = {"dolp_rmse": pooled, "s_per_mpx": seconds / pixels * 1e6}
        out[method] |= {f"dolp_rmse {name}": float(np.sqrt(squared[name] / count[name])) for name in squared}

    for colour in ("mono", "bayer"):
        for method in ("bilinear", "carriers"):
            score(
                f"mosaic {colour} {method}",
                lambda s, c=colour: mosaic_of(s, c),
                lambda samples, c=colour, m=method: demosaic(samples, ORDER, c, method=m),
                (lambda s: np.repeat(s.mean(-1, keepdims=True), 3, -1)) if colour == "mono" else (lambda s: s),
            )
    for angles in ((0, 45, 90), (0, 60, 120), (0, 45, 90, 135), (0, 30, 60, 90, 120, 150)):
        design = polariser_design(angles)

        def make(s, d=design):
            images = np.einsum("nk,hwkc->nhwc", d, s)
            return (images + np.random.default_rng(0).normal(0, NOISE, images.shape)).astype(np.float32)

        score(f"stack {' '.join(map(str, angles))}", make, lambda samples, d=design: solve_stack(samples, d)[0], lambda s: s)
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
    axes.set(xlabel="run time (CPU s per megapixel)", ylabel="RMS error of DoLP", title="Decode methods")
    axes.grid(True, which="both", alpha=0.3)
    axes.legend(fontsize=7)
    fig.tight_layout()
    fig.savefig(path, dpi=120, metadata={"Software": ""})


if __name__ == "__main__":
    main()
