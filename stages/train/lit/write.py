"""splats_lit.ply and splats_lit.spz: the trained Gaussians as viewers of 3D Gaussian splatting show them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch

from pipeline.formats import dataset_files as files
from pipeline.geometry.world_offset import ply_comment
from pipeline.splats import harmonics
from pipeline.splats.cloud import SplatCloud, turned_quaternions
from pipeline.splats.splat_ply import write_splat_ply
from pipeline.splats.spz import representable, write_spz

from ..rasterize import rasterize
from ..render_view import LEAST_ALPHA, SCREEN_FILTER, Rendered
from ..renderer import Renderer
from ..splats.gaussians import Splats, to_numpy
from ..views.source_views import SourceView
from ..views.training_frame import SceneFrame
from ..views.view import View
from .fit import fit_colours, white_of
from .samples import Samples, at, samples_of

FLAT = 4.0  # e-folds by which the third sigma is below the smallest: viewers that know only ellipsoids show discs
AROUND = 64  # more cameras about the object: what a glossy surface mirrors changes more between two captured ones than degree 3
# can tell from them alone
PIXEL = 1.5  # median sigmas a pixel of these cameras measures on the object


def cameras_around(sources: Sequence[SourceView], frame: SceneFrame, pixel: float) -> list[SourceView]:
    """Cameras on a sphere about the object, as far away as the captured ones and like the first of them, with nothing to see.

    pixel: what one of theirs measures on the object at least, world units.
    """
    like = min(sources, key=lambda s: s.name)
    centres = np.stack([s.camera.centre for s in sources]) - np.asarray(frame.centre)
    distance = float(np.median(np.linalg.norm(centres, axis=1)))
    shrunk = min(1.0, distance / (like.camera.fx * pixel))
    width, height = (max(8, round(shrunk * n)) for n in (like.camera.width, like.camera.height))
    small = like.camera.resized(width, height)
    k = np.arange(AROUND) + 0.5
    z, angle = 1 - 2 * k / AROUND, np.pi * (3 - np.sqrt(5)) * k
    out = []
    for number, d in enumerate(np.stack([np.sqrt(1 - z * z) * np.cos(angle), np.sqrt(1 - z * z) * np.sin(angle), z], -1)):
        helper = np.eye(3)[np.abs(d).argmin()]
        x = np.cross(helper, -d) / np.linalg.norm(np.cross(helper, -d))
        matrix = np.eye(4)
        matrix[:3, :3] = np.stack([x, np.cross(-d, x), -d])
        matrix[:3, 3] = -matrix[:3, :3] @ (np.asarray(frame.centre) + distance * d)
        camera = replace(small, world_to_camera=matrix, cx=width / 2, cy=height / 2)  # the captured may look past the object
        blank = np.zeros((height, width), np.float32)
        image = np.zeros((*blank.shape, like.image.shape[2], 3), np.float32)
        out.append(SourceView(f"around {number}", "left_out", camera, image, np.ones_like(blank), blank == 0))
    return out


class LitSplats:
    """Gathers what the model's images show of each Gaussian, then fits and writes.

    The images are those of the training views, and of cameras between and beyond them; the held-back views stay out, so that
    they can judge.
    """

    def __init__(self, renderer: Renderer, frame: SceneFrame) -> None:
        self.renderer, self.frame = renderer, frame
        self.samples: list[Samples] = []

    def pixel(self) -> float:
        """What a pixel of `cameras_around` measures on the object, world units."""
        return PIXEL * float(self.renderer.scene.model.activated().scales.median()) * self.frame.scale

    def keep(self, view: View, rendered: Rendered) -> None:
        """What a view shows, rendered with every pixel that the model covers."""
        self.samples.append(samples_of(rendered, view))

    @torch.no_grad()
    def cloud(self) -> tuple[SplatCloud, float]:
        """The Gaussians in the capture's world, and the radiance (in the capture's units) that is white."""
        splats = self.renderer.scene.model.activated()
        values = {name: v.astype(np.float64) for name, v in to_numpy(splats).items()}
        white = white_of(self.samples)

        def blended(coefficients: np.ndarray, s: Samples) -> np.ndarray:
            return at(shown(splats, coefficients, s, self.renderer.backend), s.pixels)

        coefficients = fit_colours(values["means"], self.samples, white, blended)
        back = self.frame.train_from_world.T
        scales = np.log(values["scales"] * self.frame.scale)
        thin = np.full(len(scales), float(scales.min()) - FLAT if len(scales) else 0.0)
        opacity = np.clip(values["opacities"], 1e-6, 1 - 1e-6)
        return SplatCloud(
            means=self.frame.points_to_world(values["means"]),
            quaternions=turned_quaternions(values["quaternions"], back),
            log_scales=np.concatenate([scales, thin[:, None]], 1),
            opacity=np.log(opacity / (1 - opacity)),
            coefficients=harmonics.turned(coefficients, back),
        ), white / self.frame.exposure


@torch.no_grad()
def shown(splats: Splats, coefficients: np.ndarray, place: View | Samples, backend: str) -> np.ndarray:
    """sRGB colours [H, W, 3] of the Gaussians (all of them, as viewers draw them) from a place, opacity divided out."""
    none = np.zeros(0)
    means = splats.means.detach().cpu().double().numpy()
    matrix = place.world_to_camera.cpu().double().numpy()
    colours = SplatCloud(means, none, none, none, coefficients).colours(-matrix[:3, :3].T @ matrix[:3, 3])
    height, width = place.size
    raster = rasterize(
        splats.means, splats.quaternions, splats.scales, splats.opacities,
        torch.as_tensor(colours, dtype=torch.float32, device=splats.means.device),
        place.world_to_camera, place.intrinsics, width, height, backend=backend, screen_filter=SCREEN_FILTER,
    )  # fmt: skip
    return (raster.features / raster.alpha.clamp_min(LEAST_ALPHA)[..., None]).cpu().numpy()


def write_lit(folder: Path, lit: LitSplats, offset: np.ndarray) -> list[str]:
    """Write splats_lit.ply and splats_lit.spz. offset [3]: was taken from all world positions. Returns warnings."""
    cloud, white = lit.cloud()
    comments = [*ply_comment(offset), f"sRGB colours of radiance divided by {white:.6g}"]
    write_splat_ply(folder / files.LIT_SPLATS, cloud, comments)
    write_spz((folder / files.LIT_SPLATS).with_suffix(".spz"), cloud)
    if (share := representable(cloud)) < 1:
        return [
            f"splats_lit.spz: {100 * (1 - share):.0f} % of the splats are smaller or larger than SPZ can hold (it counts in "
            "metres); take splats_lit.ply, or give unit_m and export"
        ]
    return []
