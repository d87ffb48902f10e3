"""The trained views as what textures are baked from: G-buffers, and the photographs' detail on their albedo."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pipeline.asset.asset import write_asset
from pipeline.asset.bake import bake
from pipeline.asset.lobes import GGX
from pipeline.asset.photo_detail import CapturedLight, photo_detail
from pipeline.asset.views import PropertyView
from pipeline.engine.stage import StageRun
from pipeline.formats import dataset_files as files
from pipeline.formats.gbuffer import SurfaceImage
from pipeline.formats.images import RGB, channel_names, read_image
from pipeline.formats.ply import Ply
from pipeline.geometry.cameras import world_offset
from pipeline.geometry.lens import frames_folder
from pipeline.geometry.mesh import Mesh

from .gbuffer import DepthView, Views

LEAST_BLUR, MOST_BLUR = 1.0, 16.0  # px: finer is noise, coarser is shading
KEPT_BYTES = 1 << 29
FILES = 6  # formats, for the bar


def write_textured(run: StageRun, mesh: Mesh, views: Views, footprint: float) -> None:
    """Bake the views into textures, and write the folder asset/."""
    p, train = run.parameters, run.inputs["train"]
    upstream = {name: run.inputs[name] for name in ("decode", "poses") if name in run.inputs}
    frames = frames_folder(upstream) if "decode" in upstream else None
    behind = 2.0 if run.capture.polarisation == "polarisers" else 1.0  # a filter takes about half
    seen = TrainedViews(views, train, frames, behind, run.capture.up, footprint)
    normals = mesh.attributes["normal"].astype(np.float64)
    with run.progress.bar("textures", total=2 * len(seen), unit="views") as bar:
        surface = bake(mesh.vertices, mesh.faces, normals, seen, p.texel_px * footprint, p.max_texture, bar.advance)
    environment = read_image(train / files.ENVIRONMENT, RGB) if (train / files.ENVIRONMENT).exists() else None
    offset = world_offset(run.inputs["poses"] / files.CAMERAS)
    with run.progress.bar("asset", total=FILES, unit="files") as bar:
        facts = {"detail": "photographs" if seen.has_photographs else "model"}
        unit_m = run.capture.config.unit_m
        folder, up = run.output / files.ASSET, run.capture.up
        write_asset(folder, surface, up, unit_m, offset, environment, facts, bar.advance, seen.lobe)
    height, width = surface.maps["albedo"].shape[:2]
    run.note("texture_size", [width, height])
    run.note("texture_guessed", surface.guessed)


class TrainedViews:
    """Every view with a G-buffer as `PropertyView`, with the photographs' detail where they are at hand."""

    def __init__(self, views: Views, train: Path, frames: Path | None, scale: float, up: str, footprint: float) -> None:
        """train: that stage's folder; frames: the folder with the frames that fit the cameras (None: none); scale: from their
        RGB to the light before any filter; up: the capture's up axis; footprint: of a pixel on the object, world units."""
        self._views, self._frames, self._scale = views, frames, scale
        facts = json.loads((train / files.LIGHTING).read_text()) if (train / files.LIGHTING).exists() else {}
        known = {key: facts[key] for key in ("lobe", "fresnel") if key in facts}
        lit = frames is not None and (train / files.ENVIRONMENT).exists()
        self.lobe = str(facts.get("lobe", GGX))
        self._light = CapturedLight(read_image(train / files.ENVIRONMENT, RGB), facts.get("up", up), **known) if lit else None
        self._blur = resolution_px(train / files.GAUSSIANS, footprint)
        self._kept: dict[str, tuple[NDArray, NDArray]] = {}
        self._room = KEPT_BYTES

    @property
    def has_photographs(self) -> bool:
        """Whether photographs sharpen the albedo."""
        return self._light is not None

    def __len__(self) -> int:
        return len(self._views)

    def __iter__(self) -> Iterator[PropertyView]:
        for name, view in zip(self._views.names, self._views):
            detail, weight = self._detail(name, view) or (None, None)
            values = np.concatenate([view.normal, view.material], -1)
            solid = np.where(view.depth > 0, view.alpha, 0)
            yield PropertyView(view.camera, values, solid, view.depth, detail, weight)

    def _detail(self, name: str, view: DepthView) -> tuple[NDArray, NDArray] | None:
        """Of one view, kept while there is room; None where there is no photograph of the G-buffer's size."""
        if self._light is None or self._frames is None:
            return None
        if name in self._kept:
            return self._kept[name]
        photograph = _photograph(files.frame(self._frames, name), self._scale)
        if photograph is None or photograph.shape[:2] != view.depth.shape:
            return None
        surface = SurfaceImage(view.normal, view.material, view.alpha, view.depth)
        found = photo_detail(photograph, surface, self._light, view.camera, self._blur)
        self._room -= sum(part.nbytes for part in found)
        if self._room > 0:
            self._kept[name] = found
        return found


def _photograph(path: Path, scale: float) -> NDArray[np.float32] | None:
    """Linear radiance [H, W, 3] of a decoded frame; `scale` times what an RGB frame holds."""
    if not path.exists():
        return None
    if "S0.R" in channel_names(path):
        return read_image(path, [f"S0.{c}" for c in RGB])
    return read_image(path, RGB) * np.float32(scale)


def resolution_px(gaussians: Path, footprint: float) -> float:
    """Standard deviation (px) of what a model's discs blur: the median of their scales, in footprints of a pixel."""
    if not gaussians.exists():
        return LEAST_BLUR
    scales = np.exp(Ply(gaussians).vertices(("scale_0", "scale_1")))
    return float(np.clip(np.median(scales) / footprint, LEAST_BLUR, MOST_BLUR))
