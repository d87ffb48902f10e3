"""Every camera of a light stage: read a band, fit it while the next one is read, write it."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from dataclasses import dataclass
from importlib.metadata import version
from itertools import chain, groupby
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.engine.stage import StageRun
from pipeline.errors import UserError
from pipeline.formats.dataset_files import FITTED_LOBE, KEPT_SAMPLES
from pipeline.rig.light_table import LightTable
from pipeline.rig.lobe_names import LOBES
from stages.olat.evidence.after_fits import Verdict
from stages.olat.evidence.before_fits import check_capture, check_rig
from stages.olat.evidence.movement_told import say_undone, tell_movement
from stages.olat.known_geometry import KnownGeometry, known_geometry, nearest_points
from stages.olat.maps.footprint import with_neighbours
from stages.olat.maps.map_files import MapWriter
from stages.olat.maps.preview import write_preview
from stages.olat.maps.sample_pixels import SampleKeeper
from stages.olat.parameters import OlatParameters, every
from stages.olat.pixel_fit.fit_options import PASSES, SPECULAR_FITS, FitOptions
from stages.olat.pixel_fit.lobe_choice import CANDIDATES, choose
from stages.olat.pixel_fit.many_pixels import fit, load, ready
from stages.olat.pixel_fit.result_layout import map_slices
from stages.olat.reading.frame_reader import Samples, ahead
from stages.olat.reading.misregistration import Misregistration
from stages.olat.reading.rig_cameras import PILOT, CameraJob, decoded, light_rig
from stages.olat.reading.scanline_bands import Band, parts_of
from stages.olat.reading.stream import Lanes, Piece

PRIOR = (1 / np.radians(0.5)) ** 2  # n_s and n_d of one surface agree to about half a degree
WIDTHS = {**dict.fromkeys(LOBES, "Beckmann/Ward widths"), "ggx": "GGX widths (alpha)"}  # what `sigma` is, for maps.json
GAIN = 0.9
MIXED = 20.1  # one chance in a hundred, of eight parameters more
LEAST_LIGHT = 0.05
NOTHING = np.empty((0, 0, 3), np.uint16)
TOLERANCE = {"float32": 3e-6, "float64": 1e-12}


def run(stage: StageRun, lanes: Lanes, surface: Path | None = None) -> None:
    """Fit every camera from its pieces, with the object's surface if one is given. Raises UserError on unreadable frames."""
    index = decoded(stage)
    parameters: OlatParameters = stage.parameters
    rig = light_rig(index, every(parameters.lights))
    level = index.get("saturation_level")
    clipped = float(index.get("saturated_fraction") or 0.0) > 0 and level is not None
    bound = clipped and parameters.overexposure != "off"
    why = "samples are clipped" if clipped else "nothing is over the saturation level"
    stage.note("overexposure", {"run": bound, "reason": why if parameters.overexposure != "off" else "overexposure=off"})
    stage.note("lights", {"used": len(rig), "of": len(index["lights"]["directions"])})
    settings = settings_of(parameters, stage.capture.config.olat, float(level) if bound and level is not None else np.inf)
    settings = settings._replace(one_pass=PASSES[lanes.jobs[0][0].passes])  # all cameras have the same
    if parameters.solver not in ("closed", "gradient") and settings.one_pass != PASSES["both"]:
        raise UserError(f"olat.solver={parameters.solver}", "needs crossed and parallel frames", "take olat.solver=closed")
    half = lanes.jobs[0][0].half
    if not ready(half, parameters.precision):
        stage.progress.say("compiling the fits for this machine (once; about a minute)")
    load(half, parameters.precision)  # while the first band is read
    stage.note("kernels", f"numba {version('numba')}")  # it compiled them, but need not be loaded
    geometry = known_geometry(stage, chain.from_iterable(lanes.jobs), surface)
    check_rig(stage, rig, stage.capture.config.olat.near_light)
    pilot, lanes.pieces[0] = _pilot(lanes.pieces[0])
    check_capture(stage, pilot, rig)
    settings = choose_lobe(stage, pilot, rig, settings)
    del pilot  # it may be a whole band
    lobe = next(name for name, value in LOBES.items() if value == settings.lobe)
    stage.note("lobe", lobe)
    facts = {"schema": 1, "lobe": lobe, "sigma": WIDTHS[lobe], "roughness": "(sigma_x sigma_y)^(1/4)"}
    (stage.output / FITTED_LOBE).write_text(json.dumps(facts, indent=1) + "\n")
    threads = max(1, (os.cpu_count() or 1) // len(lanes.jobs))

    def fit_lane(jobs: list[CameraJob], pieces: Iterator[Piece]) -> None:
        with closing(ahead(fitted(stage, pieces, rig, settings, threads, geometry))) as parts:
            for job, (_, own) in zip(jobs, groupby(parts, key=lambda part: part.piece.job.name)):
                write_camera(stage, job, own, settings)

    with ThreadPoolExecutor(len(lanes.jobs)) as pool:  # the kernels and the readers release the interpreter's lock
        for task in [pool.submit(fit_lane, *lane) for lane in zip(lanes.jobs, lanes.pieces)]:
            task.result()


def _pilot(pieces: Iterator[Piece]) -> tuple[list[Piece], Iterator[Piece]]:
    """The pieces on which the lobe is chosen, and those to fit: the first band is both."""
    pilot: list[Piece] = []
    for piece in pieces:
        if not piece.pilot:
            return [*pilot, piece], _begun([piece], pieces)
        pilot.append(piece)
    return pilot, pieces


def _begun(taken: list[Piece], pieces: Iterator[Piece]) -> Iterator[Piece]:
    """The pieces already taken, then the rest; none is held after it is handed over."""
    while taken:
        yield taken.pop(0)
    yield from pieces


def settings_of(parameters: OlatParameters, config: Any, saturation: float) -> FitOptions:
    """Kernel settings from the stage's parameters and the capture's [olat] facts."""
    return FitOptions(
        lobe=LOBES["ward" if parameters.lobe == "auto" else parameters.lobe], rounds=8, robust=2, steps=15,
        tolerance=TOLERANCE[parameters.precision], saturation=saturation,
        specular_factor=config.specular_factor, irradiance=config.irradiance, gain=GAIN, mixed=MIXED,
        prior=PRIOR, plain=parameters.diffuse_fit == "active-set",
        specular_fit=SPECULAR_FITS[parameters.specular_fit], fuse_correlation=parameters.fusion == "correlation",
        printed_maps=parameters.maps == "printed", remove=parameters.overexposure == "remove",
        gradient=parameters.solver == "gradient", one_pass=PASSES["both"],
        gap=parameters.overexposure_gap, removals=parameters.overexposure_rounds,
    )  # fmt: skip


def choose_lobe(stage: StageRun, pilot: list[Piece], rig: LightTable, settings: FitOptions) -> FitOptions:
    """Where the lobe is `auto`: the one of `CANDIDATES` that leaves the smallest residual on most of the pilot's pixels."""
    parameters: OlatParameters = stage.parameters
    if parameters.lobe != "auto" or parameters.solver != "closed":  # the other solvers are written for Ward's
        return settings
    camera, parts = pilot[0].job.camera, [piece.samples for piece in pilot]
    steps = [max(1, len(part.band.pixels) * len(parts) // PILOT) for part in parts]
    cross, parallel = (
        np.concatenate([getattr(part, side)[:, ::step] for part, step in zip(parts, steps)], 1)
        for side in ("cross", "parallel")
    )
    view = -camera.rays_through(np.concatenate([part.band.pixels[::step] for part, step in zip(parts, steps)]))
    points = nearest_points(camera, view) if stage.capture.config.olat.near_light else None

    def rows_of(name: str) -> NDArray[np.float64]:
        own = settings._replace(lobe=LOBES[name])
        return fit(cross, parallel, view, rig, own, parameters.precision, points)[0]

    found = {name: rows_of(name) for name in CANDIDATES}
    choice = choose(found)
    stage.note("lobe_pilot", {"pixels": choice.pixels, **choice.shares})
    return settings._replace(lobe=LOBES[choice.lobe])


@dataclass
class Part:
    """Some scanlines of a piece, fitted: rows [P, WIDTH] of the pixels of `band`. The piece's samples may be gone."""

    piece: Piece
    band: Band
    rows: NDArray[np.float64]
    keeper: SampleKeeper


def fitted(
    stage: StageRun,
    pieces: Iterator[Piece],
    rig: LightTable,
    settings: FitOptions,
    threads: int | None,
    geometry: KnownGeometry | None = None,
) -> Iterator[Part]:
    """Every piece, fitted in parts: one is finished and written while the next is fitted."""
    keepers: dict[str, SampleKeeper] = {}
    used = every(stage.parameters.lights) * np.arange(len(rig))
    for piece in pieces:
        job, whole = piece.job, piece.samples.band
        if job.name not in keepers:
            keepers[job.name] = SampleKeeper(job.mask, used, job.passes == "both")
        own = -job.camera.rays_through(whole.pixels)
        for part in parts_of(whole, job.camera.width):
            first, last = np.searchsorted(whole.pixels, (part.pixels[0], part.pixels[-1] + 1))
            rows = fit_part(stage, job, piece.samples, own, rig, settings, threads, (int(first), int(last)), geometry)
            keepers[job.name].add(piece.samples, rows, int(first))
            if part.bottom == whole.bottom:
                piece.samples = Samples(whole, NOTHING, NOTHING)  # what is left is to write
            yield Part(piece, part, rows, keepers[job.name])


def write_camera(stage: StageRun, job: CameraJob, parts: Iterator[Part], settings: FitOptions) -> None:
    """Finish and write the maps of one camera from its parts."""
    parameters: OlatParameters = stage.parameters
    surface, verdict, directed = parameters.widths == "surface", Verdict(), 0
    asked = ("removed",) if settings.remove else ()
    misregistration: Misregistration | None = None
    keeper: SampleKeeper | None = None
    with (
        stage.progress.bar(f"fitting {job.name}", int(job.mask.sum()), "px") as bar,
        MapWriter(stage.output / job.name, job.camera.width, job.camera.height, asked) as writer,
    ):

        def found() -> Iterator[tuple[Band, NDArray[np.float64]]]:
            nonlocal misregistration, keeper
            for part in parts:
                keeper = part.keeper
                if misregistration is None:
                    say_undone(stage, job, part.piece.undone)
                    misregistration = part.piece.misregistration
                bar.advance(len(part.rows))
                yield part.band, part.rows

        for band, rows in with_neighbours(found(), job.camera.width, surface) if not settings.gradient else found():
            if parameters.albedo_over_occlusion:
                divide_by_occlusion(rows)
            verdict.add(rows)
            directed += int(np.count_nonzero(rows[:, map_slices()["tangent"]].any(1)))
            writer.write(band, rows)
    if keeper is not None:
        keeper.write(stage.output / job.name / KEPT_SAMPLES)
    with ThreadPoolExecutor(1) as pool:
        picture = pool.submit(write_preview, stage.output / job.name / "preview.png", writer.preview)
        tell_movement(stage, job, misregistration)
        picture.result()
    stage.note(f"{job.name}.tangent_pixels", directed)
    verdict.tell(stage, job.name, lobe=job.passes == "both")


def fit_part(
    stage: StageRun, job: CameraJob, samples: Samples, view: NDArray[np.float64], rig: LightTable, settings: FitOptions,
    threads: int | None, part: tuple[int, int], geometry: KnownGeometry | None = None,
) -> NDArray[np.float64]:  # fmt: skip
    """Rows [last - first, WIDTH] of a band's pixels [first, last); view [P, 3]: unit, to the camera, of all of them."""
    parameters: OlatParameters = stage.parameters
    points = nearest_points(job.camera, view) if stage.capture.config.olat.near_light else None
    if geometry is not None:
        samples, view, points = geometry.applied(samples, job.camera, view, rig, points, part)
        part = (0, len(view))
    rows, _ = fit(samples.cross, samples.parallel, view, rig, settings, parameters.precision, points, threads, part)
    if parameters.solver not in ("closed", "gradient"):
        from stages.olat.zoo.paper_chain import solve_band

        own = slice(*part)
        near = None if points is None else points[own]
        solve_band(parameters.solver, samples.cross[:, own], samples.parallel[:, own], view[own], rig, settings, rows, near)
    return rows


def divide_by_occlusion(rows: NDArray[np.float64]) -> None:
    """PRF's optional last step, in place: albedos over occlusion, where at least a twentieth of the light arrives."""
    for albedo, occlusion in (("diffuse_albedo", "occlusion_d"), ("specular_albedo", "occlusion_s")):
        shade = rows[:, map_slices()[occlusion]]
        rows[:, map_slices()[albedo]] /= np.where(shade > LEAST_LIGHT, shade, 1.0)
