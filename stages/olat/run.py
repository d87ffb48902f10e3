"""Every camera of a light stage: read a band, fit it while the next one is read, write it."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

from pipeline.cameras import Camera, camera_from_frame
from pipeline.capture.model import LightTable
from pipeline.errors import UserError
from pipeline.images import read_mask
from pipeline.lights.lobes import LOBES
from pipeline.lights.solid_angles import solid_angles
from pipeline.stage import StageRun
from stages.olat.columns import FLAG, RESIDUAL, columns
from stages.olat.drift import WARN_PX, Drift, measure
from stages.olat.fit import fit
from stages.olat.footprint import with_neighbours
from stages.olat.frames import Band, Samples, bands_of, is_half, read_bands
from stages.olat.maps_out import MapWriter
from stages.olat.paper import SPECULAR_FITS
from stages.olat.preview import write_preview
from stages.olat.stage import OlatParameters, every
from stages.olat.workspace import Settings

FLAGS = ("good", "too few lights", "saturated", "black", "no lobe", "bad samples")
PRIOR = (1 / np.radians(0.5)) ** 2  # n_s and n_d of one surface agree to about half a degree
GAIN = 0.9
MIXED = 1.0
PILOT = 600  # pixels on which the lobe is chosen
PILOT_CHUNKS = 3  # places in the frame that they come from
LEAST_LIGHT = 0.05
TOLERANCE = {"float32": 3e-6, "float64": 1e-12}


@dataclass(frozen=True)
class CameraJob:
    """One camera's frames in the order of the lights, its pose and its mask."""

    name: str
    cross: list[Path]
    parallel: list[Path]
    camera: Camera
    mask: NDArray[np.bool_]


def run(stage: StageRun) -> None:
    """Fit every camera. Raises UserError on frames that cannot be read."""
    index = json.loads((stage.inputs["decode"] / "olat.json").read_text())
    parameters: OlatParameters = stage.parameters
    step = every(parameters.lights)
    rig = light_rig(index, step)
    level = index.get("saturation_level")
    clipped = float(index.get("saturated_fraction") or 0.0) > 0 and level is not None
    bound = clipped and parameters.overexposure != "off"
    why = "samples are clipped" if clipped else "nothing is over the saturation level"
    stage.note("overexposure", {"run": bound, "reason": why if parameters.overexposure != "off" else "overexposure=off"})
    stage.note("lights", {"used": len(rig), "of": len(index["lights"]["directions"])})
    settings = settings_of(parameters, stage.capture.config.olat, float(level) if bound else np.inf)
    if not any(Path(getattr(numba.config, "CACHE_DIR", "") or ".").glob("**/fit.fit_pixels*.nbc")):
        stage.progress.say("compiling the fits for this machine (once; about a minute)")
    jobs = [camera_job(stage, name, entry, step) for name, entry in index["cameras"].items()]
    settings = choose_lobe(stage, jobs[0], rig, settings)
    lobe = next(name for name, value in LOBES.items() if value == settings.lobe)
    stage.note("lobe", lobe)
    facts = {"schema": 1, "lobe": lobe, "sigma": "Beckmann/Ward widths", "roughness": "(sigma_x sigma_y)^(1/4)"}
    (stage.output / "maps.json").write_text(json.dumps(facts, indent=1) + "\n")
    side_by_side = max(1, min(stage.jobs, len(jobs)))
    threads = max(1, (os.cpu_count() or 1) // side_by_side)
    with ThreadPoolExecutor(side_by_side) as pool:  # the kernels and the readers release the interpreter's lock
        for task in [pool.submit(fit_camera, stage, job, rig, settings, threads) for job in jobs]:
            task.result()


def light_rig(index: dict[str, Any], step: int = 1) -> LightTable:
    """The lights of olat.json, each `step`-th, with solid angles (computed where the table has none)."""
    table = index["lights"]
    directions = np.array(table["directions"])[::step]
    positions = np.array(table["positions"])[::step]
    intensity = np.array(table["intensity"])[::step]
    given = table.get("solid_angle")
    area = np.array(given) if given is not None and step == 1 else solid_angles(directions)
    return LightTable(directions, positions, intensity, area)


def settings_of(parameters: OlatParameters, config: Any, saturation: float) -> Settings:
    """Kernel settings from the stage's parameters and the capture's [olat] facts."""
    lobe = LOBES["ward" if parameters.lobe == "auto" else parameters.lobe]
    return Settings(
        lobe=lobe, rounds=8, robust=2, steps=15, tolerance=TOLERANCE[parameters.precision], saturation=saturation,
        specular_factor=config.specular_factor, irradiance=config.irradiance, gain=GAIN, mixed=MIXED,
        prior=PRIOR, plain=parameters.diffuse_fit == "active-set",
        specular_fit=SPECULAR_FITS[parameters.specular_fit], fuse_correlation=parameters.fusion == "correlation",
        printed_maps=parameters.maps == "printed", remove=parameters.overexposure == "remove",
        gradient=parameters.solver == "gradient",
    )  # fmt: skip


def choose_lobe(stage: StageRun, job: CameraJob, rig: LightTable, settings: Settings) -> Settings:
    """Where the lobe is `auto`: Ward's or Beckmann's, by which leaves the smaller residual on more of a sample of pixels."""
    parameters: OlatParameters = stage.parameters
    if parameters.lobe != "auto" or settings.gradient:
        return settings
    half = frames_plan(job, rig, parameters)[0]
    chunks = bands_of(job.mask, len(rig), 0.0, 2)  # single chunks of scanlines: little to read
    chosen = [chunks[k] for k in sorted({len(chunks) * q // (PILOT_CHUNKS + 1) for q in range(1, PILOT_CHUNKS + 1)})]
    step = max(1, sum(len(chunk.pixels) for chunk in chosen) // PILOT)
    thinned = [replace(chunk, pixels=chunk.pixels[::step]) for chunk in chosen]
    parts = list(read_bands(job.cross, job.parallel, thinned, half))
    cross, parallel = (np.concatenate([getattr(part, side) for part in parts], 1) for side in ("cross", "parallel"))
    view = -job.camera.rays().reshape(-1, 3)[np.concatenate([chunk.pixels for chunk in thinned])]
    points = nearest_points(job.camera, view) if stage.capture.config.olat.near_light else None
    found = {}
    for name in ("ward", "beckmann"):
        trial = settings._replace(lobe=LOBES[name])
        rows, _ = fit(cross, parallel, view, rig, trial, parameters.precision, points)
        found[name] = rows
    sound = (found["ward"][:, FLAG] == 0) & (found["beckmann"][:, FLAG] == 0)
    better = found["beckmann"][sound, RESIDUAL] < found["ward"][sound, RESIDUAL]
    share = float(better.mean()) if sound.any() else 0.0
    stage.note("lobe_pilot", {"pixels": int(sound.sum()), "beckmann_fits_better": round(share, 3)})
    return settings._replace(lobe=LOBES["beckmann" if share > 0.5 else "ward"])


def frames_plan(job: CameraJob, rig: LightTable, parameters: OlatParameters) -> tuple[bool, list[Band]]:
    """Whether the frames are half floats, and the bands in which they are read."""
    half = all(is_half(path) for path in (job.cross[0], job.parallel[0]))
    return half, bands_of(job.mask, len(rig), parameters.band_mb, 2 if half else 4)


def camera_job(stage: StageRun, name: str, entry: dict[str, Any], step: int) -> CameraJob:
    """One camera of olat.json with its mask (masks stage, else the capture's, else the whole frame). Raises UserError."""
    root = stage.capture.root
    camera = camera_from_frame({"file_path": name, **entry["camera"]}, {}, stage.inputs["decode"] / "olat.json")
    made = stage.inputs["masks"] / f"{name}.png" if "masks" in stage.inputs else None
    path = made if made is not None and made.is_file() else (root / entry["mask"] if entry.get("mask") else None)
    shape = (int(entry["height"]), int(entry["width"]))
    mask = read_mask(path) if path is not None else np.ones(shape, bool)
    if mask.shape != shape:
        raise UserError(
            path or root, f"is {mask.shape[1]}x{mask.shape[0]}, the frames {shape[1]}x{shape[0]}", "make it their size"
        )
    if not mask.any():
        raise UserError(path or root, "the mask is all black: no object in this view", "mend the mask")
    cross, parallel = ([root / p for p in entry[key]][::step] for key in ("cross", "parallel"))
    return CameraJob(name, cross, parallel, camera, mask)


def fit_camera(stage: StageRun, job: CameraJob, rig: LightTable, settings: Settings, threads: int | None = None) -> None:
    """Read, fit and write one camera."""
    parameters: OlatParameters = stage.parameters
    half, bands = frames_plan(job, rig, parameters)
    view = -job.camera.rays().reshape(-1, 3)
    shift = alignment(stage, job, half)
    counts, drift, directed = np.zeros(len(FLAGS), int), Drift(job.camera.width, job.camera.height), 0
    with (
        stage.progress.bar(f"fitting {job.name}", int(job.mask.sum()), "px") as bar,
        MapWriter(stage.output / job.name, job.camera.width, job.camera.height) as writer,
    ):

        def fitted() -> Iterator[tuple[Band, NDArray[np.float64]]]:
            for samples in read_bands(job.cross, job.parallel, bands, half, shift=shift, height=job.camera.height):
                drift.add(samples)
                rows = fit_band(stage, job, samples, view[samples.band.pixels], rig, settings, threads)
                bar.advance(len(rows))
                yield samples.band, rows

        surface = parameters.widths == "surface" and not settings.gradient
        for band, rows in with_neighbours(fitted(), job.camera.width) if surface else fitted():
            if parameters.albedo_over_occlusion:
                divide_by_occlusion(rows)
            counts += np.bincount(rows[:, FLAG].astype(int), minlength=len(FLAGS))
            directed += int(np.count_nonzero(rows[:, columns()["tangent"]].any(1)))
            writer.write(band, rows)
    write_preview(stage.output / job.name / "preview.png", writer.preview)
    right, down = drift.shift()
    stage.note(f"{job.name}.drift_px", [round(right, 2), round(down, 2)])
    if max(abs(right), abs(down)) > WARN_PX:
        stage.warn(
            f"{job.name}: the parallel pass lies {right:+.1f} px right and {down:+.1f} px down of the crossed one; "
            "specular maps will show edges there: align the frames before, or capture again with the object fixed"
        )
    stage.note(f"{job.name}.tangent_pixels", directed)
    stage.note(f"{job.name}.flags", {name: int(n) for name, n in zip(FLAGS, counts) if n})


def alignment(stage: StageRun, job: CameraJob, half: bool) -> tuple[int, int]:
    """Whole pixels (right, down) by which the parallel pass lies off the crossed one; (0, 0) where `align` is off."""
    if not stage.parameters.align:
        return 0, 0
    right, down = (round(v) for v in measure(job.cross, job.parallel, job.mask, half, stage.parameters.band_mb))
    if right or down:
        stage.note(f"{job.name}.aligned_px", [right, down])
        stage.warn(
            f"{job.name}: the parallel pass lay {right:+d} px right and {down:+d} px down of the crossed one and was read back "
            "into place; capture again with the object fixed for better maps"
        )
    return right, down


def fit_band(
    stage: StageRun, job: CameraJob, samples: Samples, view: NDArray[np.float64], rig: LightTable, settings: Settings,
    threads: int | None,
) -> NDArray[np.float64]:  # fmt: skip
    """Rows [P, WIDTH] of one band; view [P, 3]: unit, to the camera."""
    parameters: OlatParameters = stage.parameters
    points = nearest_points(job.camera, view) if stage.capture.config.olat.near_light else None
    rows, _ = fit(samples.cross, samples.parallel, view, rig, settings, parameters.precision, points, threads)
    if parameters.solver not in ("closed", "gradient"):
        from stages.olat.paper_chain import solve_band

        solve_band(parameters.solver, samples.cross, samples.parallel, view, rig, settings, rows)
    return rows


def nearest_points(camera: Camera, view: NDArray[np.float64]) -> NDArray[np.float64]:
    """Where each ray passes the stage's centre [P, 3]: the surface's place, to within the object's size."""
    along = view @ camera.centre
    return camera.centre - view * along[:, None]


def divide_by_occlusion(rows: NDArray[np.float64]) -> None:
    """PRF's optional last step, in place: albedos over occlusion, where at least a twentieth of the light arrives."""
    for albedo, occlusion in (("diffuse_albedo", "occlusion_d"), ("specular_albedo", "occlusion_s")):
        shade = rows[:, columns()[occlusion]]
        rows[:, columns()[albedo]] /= np.where(shade > LEAST_LIGHT, shade, 1.0)
