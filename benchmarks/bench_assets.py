"""What other programs make of an asset: Mitsuba and Blender under a dataset's own maps, against its relit views.

    python -m benchmarks.bench_assets DATASET --environment MAP [--blender PYTHON_WITH_BPY] [--views 2] [--samples 512]
    python -m benchmarks.bench_assets --captures DIR [--capture NAME] ...: of a whole run of that capture, kept in assets.json

Foreground PSNR in dB, sRGB-encoded and clipped: each file as the program opens it, from captured cameras, without a hand edit.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.case_store import made_with
from benchmarks.stability.processor_time import processor_s
from pipeline.capture import open_capture
from pipeline.formats.images import RGB, read_image, srgb_encode, write_png, write_rgb
from pipeline.geometry.cameras import OPENGL_FROM_OPENCV, Camera, load_cameras
from stages.mesh.parameters import MeshParameters
from stages.relight.parameters import RelightParameters
from stages.train.parameters import TrainParameters

RESULTS = Path(__file__).parent / "results" / "assets.json"

BLENDER_FILES = ("blender.py", "asset.glb", "asset.usdz", "asset.obj")
MITSUBA_FROM_OPENCV = np.diag([-1.0, -1.0, 1.0, 1.0])  # x left, y up, z forward


def camera_to_asset(camera: Camera, asset_from_world: NDArray) -> NDArray:
    """Rigid motion [4, 4] from the camera (OpenCV) to the asset's frame."""
    scale = np.cbrt(np.linalg.det(asset_from_world[:3, :3]))
    out = np.eye(4)
    out[:3, :3] = asset_from_world[:3, :3] / scale @ camera.camera_to_world[:3, :3]
    out[:3, 3] = asset_from_world[:3, :3] @ camera.centre + asset_from_world[:3, 3]
    return out


def by_mitsuba(asset: Path, scene: str, environment: Path, camera: Camera, pose: NDArray, samples: int) -> NDArray:
    """Linear RGB [H, W, 3] of one view by Mitsuba 3, black beside the object."""
    import mitsuba as mi

    mi.set_variant("scalar_rgb")
    loaded = mi.load_file(str(asset / scene), envmap=str(environment), spp=samples)
    sensor = mi.load_dict({
        "type": "perspective", "to_world": mi.ScalarTransform4f(pose @ MITSUBA_FROM_OPENCV), "fov_axis": "x",
        "fov": float(np.degrees(2 * np.arctan(camera.width / 2 / camera.fx))),
        "principal_point_offset_x": camera.cx / camera.width - 0.5,
        "principal_point_offset_y": camera.cy / camera.height - 0.5,
        "near_clip": 1e-3, "far_clip": 1e6,
        "film": {"type": "hdrfilm", "width": camera.width, "height": camera.height, "rfilter": {"type": "box"}},
        "sampler": {"type": "independent", "sample_count": samples},
    })  # fmt: skip
    integrator = mi.load_dict({"type": "path", "max_depth": 5, "hide_emitters": True})
    return np.array(mi.render(loaded, sensor=sensor, integrator=integrator, spp=samples))[..., :3]


def by_blender(
    python: str, asset: Path, file: str, environment: Path, views: dict[str, tuple[Camera, NDArray]], samples: int, out: Path
) -> dict[str, NDArray]:
    """Linear RGB [H, W, 3] of views by Cycles."""
    entries = []
    for name, (c, pose) in views.items():
        numbers = {"fx": c.fx, "fy": c.fy, "cx": c.cx, "cy": c.cy, "width": c.width, "height": c.height}
        entries.append({"matrix": (pose @ OPENGL_FROM_OPENCV).tolist(), **numbers, "out": str(out / f"{file}-{name}.exr")})
    job = out / "job.json"
    job.write_text(
        json.dumps({"asset": str(asset), "file": file, "environment": str(environment), "samples": samples, "views": entries})
    )
    subprocess.run(
        [python, str(Path(__file__).with_name("render_in_blender.py")), str(job)], check=True, stdout=subprocess.DEVNULL
    )
    return {name: read_image(out / f"{file}-{name}.exr", RGB) for name in views}


def foreground_psnr(image: NDArray, truth: NDArray, inside: NDArray[np.bool_]) -> float:
    """dB over the pixels inside [H, W], sRGB-encoded."""
    difference = (srgb_encode(np.clip(image, 0, 1)) - srgb_encode(np.clip(truth, 0, 1)))[inside]
    return float(-10 * np.log10(max(float((difference.astype(np.float64) ** 2).mean()), 1e-12)))


@dataclass(frozen=True)
class Relit:
    """What is compared: a dataset's asset, a map, cameras and their motions to the asset's frame, our images of them [H, W, 3]
    linear, and the pixels that are judged [H, W]."""

    asset: Path
    environment: Path
    views: dict[str, tuple[Camera, NDArray]]
    ours: dict[str, NDArray]
    inside: dict[str, NDArray[np.bool_]]


def read(dataset: Path, environment: Path, count: int) -> Relit:
    """So many views of a dataset that was relit under this map, evenly chosen."""
    asset = (dataset / "mesh" / "current" / "asset").resolve()
    relit = dataset / "relight" / "current" / environment.stem
    cameras = load_cameras(dataset / "poses" / "current" / "cameras.json")
    matrix = np.array(json.loads((asset / "asset.json").read_text())["asset_from_world"])
    chosen = sorted(cameras)[:: max(1, len(cameras) // count)][:count]
    return Relit(
        asset, environment.resolve(),
        {name: (cameras[name], camera_to_asset(cameras[name], matrix)) for name in chosen},
        {name: read_image(relit / f"{name}.exr", [f"S0.{c}" for c in RGB]) for name in chosen},
        {name: inner(dataset / "train" / "current" / "gbuffer" / f"{name}.exr") for name in chosen},
    )  # fmt: skip


def figures(found: dict[str, NDArray], relit: Relit) -> dict[str, Any]:
    """PSNR of the object (dB) and its mean radiance beside ours by channel, in another program's pictures, means over views."""
    levels = [foreground_psnr(image, relit.ours[view], relit.inside[view]) for view, image in found.items()]
    ratios = [image[relit.inside[view]].mean(0) / relit.ours[view][relit.inside[view]].mean(0) for view, image in found.items()]
    return {"psnr_foreground": float(np.mean(levels)), "mean_ratio": np.round(np.mean(ratios, 0), 3).tolist()}


def show(name: str, found: dict[str, NDArray], relit: Relit, out: Path) -> None:
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
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("dataset", type=Path, nargs="?", help="made of a capture if it is not given")
    parser.add_argument("--environment", type=Path, help="the map, as relight was given it; must be given with a dataset")
    parser.add_argument("--captures", type=Path, default=os.environ.get("POLARFIELD_CAPTURES"))
    parser.add_argument("--capture", default="spot-venice", help="one with maps of its own")
    parser.add_argument("--blender", default="", help="a Python that has bpy")
    parser.add_argument("--files", nargs="*", default=BLENDER_FILES)
    parser.add_argument("--views", type=int, default=2)
    parser.add_argument("--samples", type=int, default=512, help="a pixel: with 48, noise took 1 to 4 dB")
    parser.add_argument("--out", type=Path, default=Path("build/bench/assets"))
    options = parser.parse_args()
    if (options.dataset is None) != (options.environment is None) or (options.dataset is None and options.captures is None):
        parser.error("give DATASET and --environment, or --captures")
    options.out.mkdir(parents=True, exist_ok=True)
    name = options.capture if options.dataset is None else options.dataset.name
    dataset, environment = (
        (options.dataset, options.environment) if options.dataset else made(options.captures, name, options.out)
    )
    relit = read(dataset, environment, options.views)
    for key in ("mitsuba asset.xml", *(f"blender {file}" for file in options.files if options.blender)):
        before = processor_s()
        found = pictures(key, relit, options)
        row = figures(found, relit) | {"seconds": round((processor_s() - before) / len(found), 2), "samples": options.samples}
        print(json.dumps({"by": key, **row}))
        show(key, found, relit, options.out)
        if options.dataset is None:
            keep(f"{name}, {key}", row)


def pictures(key: str, relit: Relit, options: argparse.Namespace) -> dict[str, NDArray]:
    """Linear RGB [H, W, 3] of every view by "PROGRAM FILE"."""
    program, _, file = key.partition(" ")
    if program == "blender":
        return by_blender(
            options.blender, relit.asset, file, relit.environment, relit.views, options.samples, options.out.resolve()
        )
    return {
        name: by_mitsuba(relit.asset, file, relit.environment, camera, pose, options.samples)
        for name, (camera, pose) in relit.views.items()
    }


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
