"""Are textures as sharp as the model: an asset's albedo, seen from held-back cameras, against the truth, beside the model's.

    python -m benchmarks.bench_textures DATASET ... [--store]

The capture must have gt/material. Errors of the albedo as the metrics stage takes them (median, relative, at the best factor of
each channel), and the RMS error at that factor; over what both model and mesh cover wholly. `ratio`: the texture's over the
model's.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.bench_assets import asset_folder, capture_of, defaults
from benchmarks.case_store import made_with
from pipeline.capture import open_capture
from pipeline.formats import dataset_files as files
from pipeline.formats.gbuffer import SurfaceImage, read_gbuffer
from pipeline.formats.gltf import GltfFile
from pipeline.formats.images import RGB, read_image, srgb_encode, write_png
from pipeline.geometry.cameras import load_cameras
from stages.metrics.image_figures import erode
from stages.metrics.material_figures import CHANNELS, material_figures
from synth.seen_texture import seen_texture

RESULTS = Path(__file__).parent / "results" / "textures.json"
FIGURES = ("albedo_rel_error", "albedo_rel_error_scaled", "albedo_rms_scaled")
INSIDE_PX = 2
"""From the edge of what model and mesh cover."""


def main() -> None:
    """Measure, print, and store if asked."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("datasets", nargs="+", type=Path)
    parser.add_argument("--store", action="store_true", help="keep the rows: the datasets were made with the defaults")
    parser.add_argument("--out", type=Path, default=Path("build/bench/textures"))
    options = parser.parse_args()
    for dataset in options.datasets:
        row = measure(dataset, options.out)
        print(json.dumps({"dataset": dataset.name, **row}), flush=True)
        if options.store:
            rows = json.loads(RESULTS.read_text()) if RESULTS.is_file() else {}
            rows[dataset.name] = {**row, "made": made_with({k: v for k, v in defaults().items() if k != "relight"})}
            RESULTS.write_text(json.dumps(rows, indent=1) + "\n")


def measure(dataset: Path, out: Path) -> dict[str, Any]:
    """Means over the held-back views: the model's and the texture's errors, and the latter over the former.

    Args:
        dataset: with its mesh stage done.
        out: receives pictures of the true, the texture's and the model's albedo side by side.

    Returns:
        {"model": {...}, "texture": {...}, "ratio": {...}, "views"}, by `FIGURES`.
    """
    truth = open_capture(capture_of(dataset)).truth
    cameras = load_cameras(dataset / "poses" / "current" / "cameras.json")
    train = dataset / "train" / "current"
    asset = read_asset(asset_folder(dataset))
    sums: dict[str, list[dict[str, float]]] = {"model": [], "texture": []}
    for view in files.held_back_views(train):
        path = truth.find("material", view)
        if path is None:
            continue
        model = read_gbuffer(train / "gbuffer" / f"{view}.exr")
        colour, covered = seen_texture(*asset, cameras[view])
        both = erode((model.alpha > 0.99) & (covered > 0.99), INSIDE_PX)
        texture = SurfaceImage(model.normal, np.concatenate([colour, model.material[..., 3:]], -1), model.alpha, model.depth)
        for kind, surface in (("model", model), ("texture", texture)):
            sums[kind].append(material_figures(path, surface, both) | rms(path, surface, both))
        true = read_image(path, CHANNELS)[..., :3]
        write_png(out / f"{dataset.name}-{view}.png", srgb_encode(np.concatenate([true, colour, model.albedo], 1).clip(0, 1)))
    if not sums["model"]:
        raise SystemExit(f"{dataset}: its capture has no true albedo (gt/material) of a held-back view")
    means = {kind: {name: float(np.mean([r[name] for r in rows])) for name in FIGURES} for kind, rows in sums.items()}
    ratio = {name: round(means["texture"][name] / means["model"][name], 4) for name in FIGURES}
    return {**means, "ratio": ratio, "views": len(sums["model"])}


def rms(path: Path, surface: SurfaceImage, where: NDArray[np.bool_]) -> dict[str, float]:
    """RMS error of the albedo at each channel's best factor, inside [H, W] and where the truth has an object."""
    true = read_image(path, CHANNELS)
    where = where & (true[..., 4] > 0)
    albedo, given = surface.albedo[where].astype(np.float64), true[where][:, :3].astype(np.float64)
    factor = (albedo * given).sum(0) / np.maximum((albedo**2).sum(0), 1e-12)
    return {"albedo_rms_scaled": float(np.sqrt(((albedo * factor - given) ** 2).mean()))}


def read_asset(folder: Path) -> tuple[NDArray, NDArray, NDArray, NDArray]:
    """The asset's vertices in the capture's world, faces, texture coordinates, and linear albedo texture."""
    file = GltfFile(folder / "asset.glb")
    primitive = file.document["meshes"][0]["primitives"][0]
    position, uv = (file.array(primitive["attributes"][name]).astype(np.float64) for name in ("POSITION", "TEXCOORD_0"))
    faces = file.array(primitive["indices"]).astype(np.int64).reshape(-1, 3)
    to_world = np.linalg.inv(np.array(json.loads((folder / "asset.json").read_text())["asset_from_world"]))
    return position @ to_world[:3, :3].T + to_world[:3, 3], faces, uv, read_image(folder / "textures" / "albedo.exr", RGB)


if __name__ == "__main__":
    main()
