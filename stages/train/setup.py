"""From loaded views to a model that can be trained."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
import torch

from pipeline.capture.model import PolariserPrior
from pipeline.geometry.silhouette_hull import Silhouette, occupancy, signed_distance

from .indirect.harmonics import start_harmonics
from .initialise.hull import HullMesh
from .initialise.openings import OpeningView, cut_openings
from .initialise.sampling import mesh_area, sample_evenly, wanted_count
from .initialise.silhouettes import are_masks, outline
from .initialise.start import start_surface
from .log_environment import Environment
from .parameters import TrainParameters
from .scene import Scene
from .splats.gaussians import SplatModel, logit
from .views.opening_pixels import has_openings, hole_coverage
from .views.polarisers import PolariserBank
from .views.source_views import (
    LEARNT,
    MEAN_EXPOSED,
    Mode,
    SourceView,
    background_is_black,
    edge_offset,
    exposure_of,
    halved,
    with_validation,
)
from .views.training_frame import SceneFrame
from .views.view import View, prepare

START_ALBEDO, START_ROUGHNESS, START_IOR = 0.35, 0.35, 1.5  # an everyday dielectric
BODY_SHARE, MIRROR_SHARE = 0.85, 0.07  # of a constant sky's light: what passes the surface in and out, and what it mirrors
NO_POINTS = np.zeros((0, 3))


@dataclass(frozen=True)
class StartFacts:
    """Whether sparse points shaped the start, why (not), and whether the pictures came with masks."""

    points: bool
    reason: str
    masked: bool


@dataclass(frozen=True)
class Start:
    """What training starts from: the scene, the views by pyramid level, the frame and facts about the data."""

    scene: Scene
    pyramids: list[list[View]]
    frame: SceneFrame
    hull: HullMesh  # in the training frame
    black_background: bool
    pixel: float  # a full-size pixel's width on the object, training units
    facts: StartFacts


def prepare_training(
    sources: list[SourceView],
    mode: Mode,
    priors: Mapping[str, PolariserPrior],
    up: str,
    parameters: TrainParameters,
    device: str,
    points: np.ndarray = NO_POINTS,
    cut: bool = True,
) -> Start:
    """Hull, splats, environment, polarisers and views in the training frame. Test views enter nowhere here.

    Args:
        sources: every view, as loaded.
        mode: what the views hold.
        priors: what is known of each camera's polariser.
        up: the capture's up axis ("y", "-y", ...).
        parameters: the stage's.
        device: torch device of the tensors.
        points: the poses stage's sparse points, if any, in the capture's world. [N, 3]
        cut: cut openings out of the start.

    Raises:
        UserError: masks or cameras that no surface can be made of.
    """
    sources = with_validation(sources, parameters.validation_every)
    seen = [s for s in sources if s.split in LEARNT]
    masked = are_masks([s.mask for s in seen])
    black = background_is_black(seen)
    offset = edge_offset(seen) if black else 0.0
    silhouettes = [Silhouette(s.camera, s.mask) for s in seen if (s.mask > 0.5).any()]
    begun = start_surface(silhouettes, points, parameters.start, masked, parameters.hull_resolution, offset)
    hull, centre, half = begun.mesh, begun.centre, begun.half
    if begun.points and not masked:  # what the points' surface covers is the object
        sources = [replace(s, mask=outline(hull, s.camera)) for s in sources]
        seen = [s for s in sources if s.split in LEARNT]
        black = background_is_black(seen)
    exposure = exposure_of(seen) * (1.0 if mode != "polarisers" else 0.5)
    frame = replace(SceneFrame.of(up, centre, half), exposure=exposure)
    hull = HullMesh(
        (hull.vertices - centre) @ frame.train_from_world.T / half, hull.triangles, hull.normals @ frame.train_from_world.T
    )
    pixel = float(np.median([_pixel_width(s, frame) for s in seen]))
    openings = has_openings(seen, exposure)
    closed = hull if openings and cut else None
    if closed is not None:
        hull = _with_openings(hull, seen, frame, pixel, None if begun.points else offset)
    model = _start_model(hull, seen, pixel, parameters, device)
    environment = start_environment(parameters, device)
    bank = PolariserBank(priors, sorted({s.camera.name for s in seen}), device) if mode == "polarisers" else None
    levels = [sources]
    if _begins_coarse(seen, parameters):
        levels.append([halved(s) for s in sources])
    pyramids = [[prepare(s, frame, black, device, openings) for s in level if s.split in LEARNT] for level in levels]
    found = StartFacts(begun.points, begun.reason, masked)
    return Start(Scene(model, environment, bank, hull, closed), pyramids, frame, hull, black, pixel, found)


def _begins_coarse(seen: list[SourceView], parameters: TrainParameters) -> bool:
    """Whether the first steps see images of half the size."""
    covered = float(np.mean([(s.mask > 0.5).sum() for s in seen]))
    return parameters.begins_coarse(covered)


def _start_model(hull: HullMesh, seen: list[SourceView], pixel: float, parameters: TrainParameters, device: str) -> SplatModel:
    """Gaussians evenly on the hull, about `splat_pixels` apart, in the photographs' mean colour."""
    covered = float(np.mean([(s.mask > 0.5).sum() for s in seen]))
    most = round(parameters.start_fraction * parameters.most_splats(covered))
    count = wanted_count(mesh_area(hull), pixel, parameters.splat_pixels, most)
    samples = sample_evenly(hull, count, np.random.default_rng(parameters.seed))
    model = SplatModel.from_samples(samples, START_ALBEDO, START_ROUGHNESS, START_IOR, device)
    _tint(model, seen)
    if parameters.indirect == "sh":
        start_harmonics(model)
    return model


def start_environment(parameters: TrainParameters, device: str = "cpu") -> Environment:
    """What a grey object of the start's albedo must be lit by to look as bright as the photographs do."""
    radiance = MEAN_EXPOSED / (BODY_SHARE * START_ALBEDO + MIRROR_SHARE)
    return Environment(parameters.environment_resolution, radiance, device, parameters.environment_activation)


def _with_openings(hull: HullMesh, seen: list[SourceView], frame: SceneFrame, pixel: float, offset: float | None) -> HullMesh:
    """The hull (training frame) with its openings cut; `offset` of the masks, or None where it is not their hull."""
    views = [OpeningView(frame.camera(s.camera), hole_coverage(s, frame.exposure)) for s in seen]
    silhouettes = [Silhouette(view.camera, s.mask) for view, s in zip(views, seen) if (s.mask > 0.5).any()]
    if offset is None:
        return cut_openings(hull, views, pixel) or hull
    distances = [signed_distance(s.mask, offset) for s in silhouettes]
    return cut_openings(hull, views, pixel, lambda points: occupancy(silhouettes, distances, points)) or hull


def _pixel_width(source: SourceView, frame: SceneFrame) -> float:
    camera = frame.camera(source.camera)
    distance = float(np.linalg.norm(camera.centre))
    return distance / (0.5 * (camera.fx + camera.fy))


def _tint(model: SplatModel, seen: list[SourceView]) -> None:
    """Start the albedo at the photographs' mean colour: the light is taken to be white until reflections say otherwise."""
    mean = np.mean([s.image[:, :, 0][s.mask > 0.5].mean(0) for s in seen if (s.mask > 0.5).any()], 0)
    colour = np.clip(START_ALBEDO * mean / max(float(mean.mean()), 1e-30), 0.03, 0.9)
    raw = model.tensors["albedo"]
    start = logit(torch.as_tensor(colour, dtype=torch.float32)).to(raw.device)
    model.tensors["albedo"] = start.expand_as(raw).clone().requires_grad_(True)
