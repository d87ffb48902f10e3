"""What other programs make of an asset: Mitsuba, Blender, three.js and the report's viewer, against a dataset's relit views.

    python -m benchmarks.bench_assets DATASET --environment MAP [--views 2] [--samples 512] [--store]
        [--blender PYTHON_WITH_BPY] [--three NODE_MODULES_WITH_THREE] [--only PROGRAM ...]
    python -m benchmarks.bench_assets --captures DIR [--capture NAME] ...: of a whole run of that capture, kept in assets.json

Foreground PSNR in dB, sRGB-encoded and clipped: each file as the program opens it, from captured cameras, without a hand edit;
where the capture has path-traced truth under that map, theirs and ours against it as well.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.asset_renderers import Blender, by_blender, by_mitsuba, by_three, by_viewer, camera_to_asset
from benchmarks.browser_arrays import CHROMIUM
from benchmarks.case_store import made_with
from benchmarks.stability.processor_time import processor_s
from pipeline.capture import open_capture
from pipeline.formats.images import RGB, S0, channel_names, read_image, srgb_encode, write_png, write_rgb
from pipeline.geometry.cameras import Camera, load_cameras
from stages.mesh.parameters import MeshParameters
from stages.relight.parameters import RelightParameters
from stages.train.parameters import TrainParameters

RESULTS = Path(__file__).parent / "results" / "assets.json"

BLENDER_FILES = ("blender.py", "asset.glb", "asset.usdz", "asset.obj")


def foreground_psnr(image: NDArray, truth: NDArray, inside: NDArray[np.bool_], again: NDArray | None = None) -> float:
    """dB over the pixels inside [H, W], sRGB-encoded; again: the image with other noise, so that none of it counts."""
    errors = [
        (srgb_encode(np.clip(x, 0, 1)) - srgb_encode(np.clip(truth, 0, 1)))[inside].astype(np.float64)
        for x in (image, image if again is None else again)
    ]
    return float(-10 * np.log10(max(float((errors[0] * errors[1]).mean()), 1e-12)))


@dataclass(frozen=True)
class Relit:
    """What is compared: a dataset's asset, a map, cameras and their motions to the asset's frame, our images of them [H, W, 3]
    linear, the pixels that are judged [H, W], and path-traced truth [H, W, 3] where there is any."""

    dataset: Path
    environment: Path
    views: dict[str, tuple[Camera, NDArray]]
    ours: dict[str, NDArray]
    inside: dict[str, NDArray[np.bool_]]
    truth: dict[str, NDArray]

    @property
    def asset(self) -> Path:
        """The folder of the asset's files."""
        return asset_folder(self.dataset)


def asset_folder(dataset: Path) -> Path:
    """Where a dataset's asset lies."""
    return (dataset / "mesh" / "current" / "asset").resolve()


def read(dataset: Path, environment: Path, count: int) -> Relit:
    """So many views of a dataset that was relit under this map, evenly chosen, of those with truth where there are any."""
    relit = dataset / "relight" / "current" / environment.stem
    cameras = load_cameras(dataset / "poses" / "current" / "cameras.json")
    matrix = np.array(json.loads((asset_folder(dataset) / "asset.json").read_text())["asset_from_world"])
    truth = open_capture(capture_of(dataset)).truth
    paths = {name: truth.find(f"relight/{environment.stem}", name) for name in sorted(cameras)}
    known = {name: path for name, path in paths.items() if path is not None}
    names = sorted(known or cameras)
    chosen = names[:: max(1, len(names) // count)][:count]
    return Relit(
        dataset, environment.resolve(),
        {name: (cameras[name], camera_to_asset(cameras[name], matrix)) for name in chosen},
        {name: rgb(relit / f"{name}.exr") for name in chosen},
        {name: inner(dataset / "train" / "current" / "gbuffer" / f"{name}.exr") for name in chosen},
        {name: rgb(known[name]) for name in chosen if name in known},
    )  # fmt: skip


def capture_of(dataset: Path) -> Path:
    """The capture that a dataset was made of."""
    return (dataset / json.loads((dataset / "dataset.json").read_text())["capture"]).resolve()


def rgb(path: Path) -> NDArray[np.float32]:
    """Linear radiance [H, W, 3] of an image or a Stokes image."""
    return read_image(path, S0 if "S0.R" in channel_names(path) else RGB)


Pictures = dict[str, NDArray]
"""Linear RGB [H, W, 3] by view."""


def figures(parts: Sequence[Pictures], relit: Relit) -> dict[str, Any]:
    """Of another program's pictures (two with noise of their own, or one without): PSNR of the object against ours (dB), as
    they are and without their noise, its mean radiance over ours by channel, and both against the truth; means over views."""
    found = mean_of(parts)
    kept = {view: (relit.ours[view], inside) for view, inside in relit.inside.items()}
    known = {view: (truth, relit.inside[view]) for view, truth in relit.truth.items()}
    ratios = [image[relit.inside[view]].mean(0) / relit.ours[view][relit.inside[view]].mean(0) for view, image in found.items()]
    out: dict[str, Any] = {
        "psnr_foreground": mean_psnr([found], kept), "psnr_noiseless": mean_psnr(parts, kept),
        "mean_ratio": np.round(np.mean(ratios, 0), 3).tolist(),
    }  # fmt: skip
    if known:
        out |= {"psnr_truth": mean_psnr(parts, known), "psnr_truth_ours": mean_psnr([relit.ours], known)}
    return out


def mean_psnr(parts: Sequence[Pictures], against: Mapping[str, tuple[NDArray, NDArray[np.bool_]]]) -> float:
    """Of the views that are `against` (a picture, and the pixels that count)."""
    levels = [foreground_psnr(parts[0][view], *other, parts[-1][view]) for view, other in against.items()]
    return float(np.mean(levels))


def mean_of(parts: Sequence[Pictures]) -> Pictures:
    """The mean picture of each view."""
    return {view: np.mean([part[view] for part in parts], 0) for view in parts[0]}


def show(name: str, found: Pictures, relit: Relit, out: Path) -> None:
    """Write each picture beside ours and their difference (PNG), and as it is (EXR)."""
    for view, image in found.items():
        ours, stem = relit.ours[view], f"{name.replace(' ', '-')}-{view}"
        panels = (image, ours, 0.5 + image - ours)
        write_png(out / f"{stem}.png", np.concatenate([srgb_encode(np.clip(panel, 0, 1)) for panel in panels], 1))
        write_rgb(out / f"{stem}-linear.exr", image)


def made(captures: Path, name: str, out: Path) -> tuple[Path, Path]:
    """The dataset of a capture, made or brought up to date by the whole program, and the first map that it was relit under."""
    dataset = out / name
    command = [sys.executable, "-m", "stages", "all", str(captures / name), "--dataset", str(dataset), "--quiet"]
    subprocess.run(command, check=True)
    return dataset, open_capture(captures / name).environments[0]


def main() -> None:
    """Compare every file of a dataset's asset under a map of its relight stage."""
    options = parsed()
    options.out.mkdir(parents=True, exist_ok=True)
    name = options.name or (options.capture if options.dataset is None else options.dataset.name)
    dataset, environment = (
        (options.dataset, options.environment) if options.dataset else made(options.captures, name, options.out)
    )
    relit = read(dataset, environment, options.views)
    for key in programs(options):
        before = processor_s()
        parts = pictures(key, relit, options)
        spent = round((processor_s() - before) / len(relit.views), 2)
        row = figures(parts, relit) | {"seconds": spent, "samples": options.samples if len(parts) > 1 else None}
        print(json.dumps({"by": key, **row}), flush=True)
        show(key, mean_of(parts), relit, options.out)
        if options.dataset is None or options.store:
            keep(f"{name}, {key}", row)


def parsed() -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("dataset", type=Path, nargs="?", help="made of a capture if it is not given")
    parser.add_argument("--environment", type=Path, help="the map, as relight was given it; must be given with a dataset")
    parser.add_argument("--captures", type=Path, default=os.environ.get("POLARFIELD_CAPTURES"))
    parser.add_argument("--capture", default="spot-venice", help="one with maps of its own")
    parser.add_argument("--store", action="store_true", help="keep a given dataset's rows too: it was made with the defaults")
    parser.add_argument("--name", default="", help="what kept rows call the capture (default: the folder's name)")
    parser.add_argument("--blender", default="", help="a Python that has bpy")
    parser.add_argument("--three", type=Path, help="npm's node_modules with three in it")
    parser.add_argument("--only", nargs="*", choices=("mitsuba", "blender", "three", "viewer"), help="these programs")
    parser.add_argument("--files", nargs="*", default=BLENDER_FILES)
    parser.add_argument("--views", type=int, default=2)
    parser.add_argument("--samples", type=int, default=512, help="a pixel: with 48, noise took 1 to 4 dB")
    parser.add_argument("--out", type=Path, default=Path("build/bench/assets"))
    options = parser.parse_args()
    if (options.dataset is None) != (options.environment is None) or (options.dataset is None and options.captures is None):
        parser.error("give DATASET and --environment, or --captures")
    return options


def programs(options: argparse.Namespace) -> list[str]:
    """ "PROGRAM FILE" of everything that can be had here."""
    keys = ["mitsuba asset.xml"]
    keys += ["viewer report.html"] if CHROMIUM else []
    keys += ["three asset.glb"] if CHROMIUM and options.three else []
    keys += [f"blender {file}" for file in options.files if options.blender]
    return [key for key in keys if not options.only or key.partition(" ")[0] in options.only]


def pictures(key: str, relit: Relit, options: argparse.Namespace) -> list[Pictures]:
    """Of every view by "PROGRAM FILE": one set, or two with half of the samples each where they are noisy."""
    program, _, file = key.partition(" ")
    environment, views, samples = relit.environment, relit.views, max(1, options.samples // 2)
    if program == "three":
        return [by_three(options.three, relit.asset / file, environment, views)]
    if program == "viewer":
        return [by_viewer(relit.dataset / "metrics" / "current" / file, environment.stem, views)]
    if program == "blender":
        blender = Blender(options.blender, relit.asset, samples, options.out.resolve())
        return [by_blender(blender, file, environment, views, seed) for seed in (0, 1)]
    return [
        {name: by_mitsuba(relit.asset, file, environment, *placed, samples, seed) for name, placed in views.items()}
        for seed in (0, 1)
    ]


def keep(name: str, row: dict[str, Any]) -> None:
    """Put a row in the stored results, with what the asset was made with."""
    rows = json.loads(RESULTS.read_text()) if RESULTS.is_file() else {}
    rows[name] = {**row, "made": made_with(defaults())}
    RESULTS.write_text(json.dumps(rows, indent=1) + "\n")


def defaults() -> dict[str, Any]:
    """Parameters that the stored rows depend on."""
    return {"train": asdict(TrainParameters()), "mesh": asdict(MeshParameters()), "relight": asdict(RelightParameters())}


def inner(gbuffer: Path) -> NDArray[np.bool_]:
    """Wholly covered pixels, two from the outline."""
    from scipy.ndimage import binary_erosion

    return np.asarray(binary_erosion(read_image(gbuffer, ["alpha"])[..., 0] > 0.99, iterations=2))


if __name__ == "__main__":
    main()
