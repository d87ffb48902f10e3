"""What other programs make of an asset: Mitsuba and Blender under a dataset's own maps, against its relit views.

    python -m benchmarks.bench_assets DATASET [--blender PYTHON_WITH_BPY] [--views 2] [--samples 512] [--out FOLDER]

Foreground PSNR in dB, sRGB-encoded and clipped: each file as the program opens it, from captured cameras, without a hand edit.
"""

from __future__ import annotations

import argparse
import json
import subprocess
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pipeline.formats.images import RGB, read_image, srgb_encode, write_png, write_rgb
from pipeline.geometry.cameras import OPENGL_FROM_OPENCV, Camera, load_cameras

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


def main() -> None:
    """Compare every file of a dataset's asset under every map of its relight stage."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("dataset", type=Path)
    parser.add_argument("--asset", type=Path)
    parser.add_argument("--relight", type=Path)
    parser.add_argument("--environment", type=Path, required=True, help="the map, as relight was given it")
    parser.add_argument("--blender", default="")
    parser.add_argument("--files", nargs="*", default=BLENDER_FILES)
    parser.add_argument("--views", type=int, default=2)
    parser.add_argument("--samples", type=int, default=512, help="a pixel: with 48, noise alone took 1 to 4 dB")
    parser.add_argument("--out", type=Path, default=Path("build/assets"))
    options = parser.parse_args()
    asset = (options.asset or options.dataset / "mesh" / "current" / "asset").resolve()
    relit = (options.relight or options.dataset / "relight" / "current") / options.environment.stem
    cameras = load_cameras(options.dataset / "poses" / "current" / "cameras.json")
    matrix = np.array(json.loads((asset / "asset.json").read_text())["asset_from_world"])
    chosen = sorted(cameras)[:: max(1, len(cameras) // options.views)][: options.views]
    views = {name: (cameras[name], camera_to_asset(cameras[name], matrix)) for name in chosen}
    ours = {name: read_image(relit / f"{name}.exr", [f"S0.{c}" for c in RGB]) for name in chosen}
    inside = {name: inner(options.dataset / "train" / "current" / "gbuffer" / f"{name}.exr") for name in chosen}
    options.out.mkdir(parents=True, exist_ok=True)
    environment = options.environment.resolve()
    pictures = {
        "mitsuba asset.xml": {
            n: by_mitsuba(asset, "asset.xml", environment, c, p, options.samples) for n, (c, p) in views.items()
        }
    }
    for file in options.files if options.blender else ():
        pictures[f"blender {file}"] = by_blender(
            options.blender, asset, file, environment, views, options.samples, options.out.resolve()
        )
    for name, found in pictures.items():
        figures = {view: round(foreground_psnr(found[view], ours[view], inside[view]), 2) for view in chosen}
        bias = {
            view: np.round(found[view][inside[view]].mean(0) / ours[view][inside[view]].mean(0), 3).tolist() for view in chosen
        }
        print(json.dumps({"by": name, "psnr_foreground": figures, "mean_ratio": bias}))
        for view in chosen:
            write_png(
                options.out / f"{name.replace(' ', '-')}-{view}.png",
                np.concatenate(
                    [srgb_encode(np.clip(i, 0, 1)) for i in (found[view], ours[view], 0.5 + found[view] - ours[view])], 1
                ),
            )
            write_rgb(options.out / f"{name.replace(' ', '-')}-{view}-linear.exr", found[view])


def inner(gbuffer: Path) -> NDArray[np.bool_]:
    """Wholly covered pixels, two from the outline."""
    from scipy.ndimage import binary_erosion

    return np.asarray(binary_erosion(read_image(gbuffer, ["alpha"])[..., 0] > 0.99, iterations=2))


if __name__ == "__main__":
    main()
