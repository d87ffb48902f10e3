"""The stage on large frames: wall time against only reading them, and peak memory at two heights."""

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

import numpy as np

from benchmarks.olat_pixels import VIEW, make, rig_of, unit
from pipeline.images import write_exr, write_mask

REPEATS = 3
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


def read_only(root: Path, dataset: Path) -> tuple[float, float]:
    """Wall and processor seconds to read the same bands of the same frames and drop them."""
    from pipeline.images import read_mask
    from stages.olat.bands import bands_of
    from stages.olat.frames import read_bands
    from stages.olat.stage import OlatParameters

    entry = json.loads((dataset / "decode" / "current" / "olat.json").read_text())["cameras"]["cam00"]
    cross, parallel = ([root / path for path in entry[key]] for key in ("cross", "parallel"))
    mask = read_mask(root / entry["mask"])
    bands = bands_of(mask, len(cross), OlatParameters().band_mb, 2)
    start, cpu = time.perf_counter(), time.process_time()
    for _ in read_bands(cross, parallel, bands, (mask.shape[1], mask.shape[0]), True):
        pass
    return time.perf_counter() - start, time.process_time() - cpu


def measure(width: int, height: int, lights: int) -> dict[str, float]:
    """Write a capture, run the stage on it in a process of its own and read it alone, in turn; medians of `REPEATS`."""
    with tempfile.TemporaryDirectory() as made:
        root, dataset = Path(made) / "capture", Path(made) / "dataset"
        pixels = write_capture(root, width, height, lights)
        command = [sys.executable, "-m", "stages", "olat", str(root), "--dataset", str(dataset)]
        runs = []
        for _ in range(REPEATS):
            shutil.rmtree(dataset / "olat", ignore_errors=True)
            subprocess.run(command, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
            manifest = json.loads((dataset / "olat" / "current" / "manifest.json").read_text())
            reading, reading_cpu = read_only(root, dataset)
            wall, cpu = manifest["wall_s"], manifest["cpu_s"]
            runs.append({
                "wall_s": wall, "cpu_s": cpu, "reading_s": reading, "wall_over_reading": wall / reading,
                "reading_cpu_s": reading_cpu, "cpu_over_reading": cpu / reading_cpu, "peak_rss_mb": manifest["peak_rss_mb"],
                "load": os.getloadavg()[0],
            })  # fmt: skip
    found: dict[str, float] = {"width": width, "height": height, "lights": lights, "pixels": pixels}
    found |= {key: float(np.median([run[key] for run in runs])) for key in runs[0]}
    print("  " + "  ".join(f"{k} {v:.4g}" for k, v in found.items()), flush=True)
    return found


def large_frames(width: int = 192, heights: tuple[int, ...] = (256, 1536), lights: int = 346) -> list[dict[str, float]]:
    """`measure` at growing heights; a small first run leaves compilation out."""
    with tempfile.TemporaryDirectory() as made:
        root = Path(made) / "capture"
        write_capture(root, 64, 64, 60)
        command = [sys.executable, "-m", "stages", "olat", str(root), "--dataset", str(Path(made) / "dataset")]
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    return [measure(width, height, lights) for height in heights]
