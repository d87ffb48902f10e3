"""The stage on large frames: wall time against only reading them, peak memory at two heights, and frames of full size."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.formats.images import read_mask, write_exr, write_mask
from stages.olat.parameters import OlatParameters
from stages.olat.reading.frame_reader import is_half, read_bands
from stages.olat.reading.scanline_bands import bands_of
from synth.olat_pixels import VIEW, make, rig_of, unit

REPEATS = 5
FULL = (3240, 6144)
"""Width and height of the frames of an LSX3 camera, as PRF used it: eight cameras, 346 lights, two passes."""
SHARE = 0.35  # of the frame that the object is across where frames of full size are made: a tenth of the pixels
BASE = 2000  # pixels that a frame is drawn from, at random: as incompressible as noise makes real frames
CAMERA = """#focal length
{focal} {focal}
#principal point
{x} {y}
#resolution
{width} {height}
#distortion coeffs
0 0 0 0
MATRIX :
{matrix}
"""


def write_capture(root: Path, width: int, height: int, lights: int, disc: float = 0.7) -> int:
    """A light stage of one camera with `lights` half-float frames a pass, the object an ellipse. Returns its pixels.

    The camera is far away, so that all pixels share the view direction that they were made for.
    """
    rig = rig_of(lights)
    p = make(BASE, rig=rig, sigma=None, lobe="beckmann", noise=1e-3, shadow=0.3, views=0.0, seed=11)
    folder = root / "cam00"
    y, x = np.mgrid[:height, :width]
    mask = ((x / width - 0.5) ** 2 + (y / height - 0.5) ** 2) < (disc / 2) ** 2
    chosen = np.random.default_rng(0).integers(BASE, size=int(mask.sum()))

    def write(k: int) -> None:
        for name, samples in (("cross", p.cross), ("parallel", p.parallel)):
            image = np.zeros((height, width, 3), np.float32)
            image[mask] = samples[k][chosen]
            write_exr(folder / name / f"{k:06d}.exr", {c: image[..., i] for i, c in enumerate("RGB")}, half=True)

    with ThreadPoolExecutor(2) as pool:
        list(pool.map(write, range(lights)))
    write_mask(folder / "mask.png", mask)
    (root / "cameras").mkdir(parents=True, exist_ok=True)
    back = unit(np.array(VIEW))
    right = unit(np.cross([0.0, 1.0, 0.0], back))
    pose = np.eye(4)
    pose[:3] = np.stack([right, np.cross(back, right), back, 1e5 * back], 1)
    matrix = "\n".join(" ".join(f"{v:.9f}" for v in row) for row in pose)
    text = CAMERA.format(matrix=matrix, focal=200 * height, x=width / 2, y=height / 2, width=width, height=height)
    (root / "cameras" / "camera00.txt").write_text(text)
    rows = "\n".join(f"{k},{x},{y},{z}" for k, (x, y, z) in enumerate(rig.positions))
    (root / "lights.csv").write_text(f"index,x,y,z\n{rows}\n")
    return int(mask.sum())


def read_only(root: Path, dataset: Path) -> float:
    """Wall seconds to read the bands that the stage reads, with its reader and its threads, and drop them."""
    start = time.perf_counter()
    for name, entry in _cameras(dataset).items():
        cross, parallel = ([root / path for path in entry[key]] for key in ("cross", "parallel"))
        made = dataset / "masks" / "current" / f"{name}.png"
        mask = read_mask(made if made.is_file() else root / entry["mask"])
        bands = bands_of(mask, len(cross), OlatParameters().band_mb, 2)
        for _ in read_bands(cross, parallel, bands, (mask.shape[1], mask.shape[0]), is_half(cross[0])):
            pass
    return time.perf_counter() - start


def read_by_openimageio(root: Path, dataset: Path, threads: int) -> float:
    """Wall seconds to read the same frames whole, one after another, through OpenImageIO."""
    import OpenImageIO as oiio

    def read(path: str) -> None:
        image = oiio.ImageInput.open(path)
        image.read_image(image.spec().format)
        image.close()

    paths = [str(root / p) for entry in _cameras(dataset).values() for key in ("cross", "parallel") for p in entry[key]]
    start = time.perf_counter()
    with ThreadPoolExecutor(threads) as pool:
        list(pool.map(read, paths))
    return time.perf_counter() - start


def _cameras(dataset: Path) -> dict[str, Any]:
    return json.loads((dataset / "decode" / "current" / "olat.json").read_text())["cameras"]


def measure(root: Path) -> dict[str, float | str]:
    """Run the stage on a capture in a process of its own and read its frames alone, in turn; medians of `REPEATS`."""
    with tempfile.TemporaryDirectory() as made:
        dataset = Path(made) / "dataset"
        command = [sys.executable, "-m", "stages", "olat", str(root), "--dataset", str(dataset)]
        runs = []
        for turn in range(REPEATS + 1):
            shutil.rmtree(dataset / "olat", ignore_errors=True)
            subprocess.run(command, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
            manifest = json.loads((dataset / "olat" / "current" / "manifest.json").read_text())
            wall, reading = manifest["wall_s"], read_only(root, dataset)
            plain = {f"openimageio_{n}_s": read_by_openimageio(root, dataset, n) for n in (2, 1)}
            if turn == 0:
                continue  # it may have compiled the kernels
            runs.append({
                "wall_s": wall, "cpu_s": manifest["cpu_s"], "peak_rss_mb": manifest["peak_rss_mb"], "reading_s": reading,
                **plain,
                "wall_over_reading": wall / reading, "wall_over_openimageio_2": wall / plain["openimageio_2_s"],
                "wall_over_openimageio_1": wall / plain["openimageio_1_s"], "load": os.getloadavg()[0],
            })  # fmt: skip
        pixels = sum(sum(facts.values()) for key, facts in manifest["facts"].items() if key.endswith(".flags"))
        width, height = (int(next(iter(_cameras(dataset).values()))[key]) for key in ("width", "height"))
    found: dict[str, float | str] = {"capture": root.name, "width": width, "height": height, "pixels": pixels}
    found |= {key: float(np.median([run[key] for run in runs])) for key in runs[0]}
    print("  " + "  ".join(f"{k} {v if isinstance(v, str) else format(v, '.4g')}" for k, v in found.items()), flush=True)
    return found


def large_frames(
    captures: Path | None = None, width: int = 192, heights: tuple[int, ...] = (256, 1536), lights: int = 346
) -> list[dict[str, float | str]]:
    """`measure` on frames of noise at growing heights, and on the light stages with ground truth in `captures`."""
    found = []
    for height in heights:
        with tempfile.TemporaryDirectory() as made:
            root = Path(made) / f"noise-{width}x{height}"
            write_capture(root, width, height, lights)
            found.append(measure(root))
    stages = sorted(path.parent for path in captures.glob("*/gt_brdf.json")) if captures else []
    return found + [measure(root) for root in stages]


def full_size(lights: int = 16, steps: tuple[int, ...] = (8, 1), kept: Path | None = None) -> dict[str, Any]:
    """One camera of full-size frames with every 8th and with all of a few lights: memory, and what a frame more takes.

    Reading grows with the frames, what is written does not: a line through the runs tells them apart (a frame's share of the
    fits is with the frame). kept: where the capture is, or is left.
    """
    found: list[dict[str, float]] = []
    with tempfile.TemporaryDirectory() as made:
        root = kept or Path(made) / "full-size"
        if not root.is_dir():
            write_capture(root, *FULL, lights, SHARE)
        pixels = int(np.count_nonzero(read_mask(root / "cam00" / "mask.png")))
        stored = sum(path.stat().st_size for path in root.rglob("*.exr")) / (2 * lights)
        for step in steps:
            dataset = Path(made) / f"dataset-{step}"
            command = [sys.executable, "-m", "stages", "olat", str(root), "--dataset", str(dataset)]
            subprocess.run([*command, "--params", f"olat.lights=every={step}"], check=True, stdout=subprocess.DEVNULL)
            olat, decode = (json.loads((dataset / s / "current" / "manifest.json").read_text()) for s in ("olat", "decode"))
            row = {"lights": -(-lights // step), **{key: olat[key] for key in ("peak_rss_mb", "cpu_s", "wall_s")}}
            row |= {f"decode_{key}": decode[key] for key in ("peak_rss_mb", "cpu_s")}
            found.append(row)
            print("  " + "  ".join(f"{k} {v:.4g}" for k, v in row.items()), flush=True)
            shutil.rmtree(dataset)
    frames = np.array([2 * row["lights"] for row in found])
    a_frame, rest = np.polyfit(frames, [row["cpu_s"] for row in found], 1)
    return {
        "width": FULL[0], "height": FULL[1], "pixels": pixels, "frame_mb": stored / 2**20, "runs": found,
        "cpu_s_a_frame": float(a_frame), "cpu_s_besides": float(rest),
    }  # fmt: skip
