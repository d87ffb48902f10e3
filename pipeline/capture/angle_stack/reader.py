"""An angle stack to its Stokes image, band by band: no frame of it is ever whole in memory unless it must be."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pipeline.capture.angle_stack.checks import (
    OTHER_PICTURES,
    angles_misfit,
    moved,
    sample_noise,
    twins,
    unexplained,
)
from pipeline.capture.angle_stack.movement import edge_strength, largest_shift, registered
from pipeline.capture.angle_stack.solve import StackSolver, design_covariance, polariser_design
from pipeline.capture.config import CaptureConfig, PolariserConfig
from pipeline.capture.model import DecodedView
from pipeline.capture.naming.files import RAW_SUFFIXES
from pipeline.capture.naming.grouping import Exposure, Group
from pipeline.capture.pixels.brackets import read_exposures
from pipeline.capture.pixels.frame_memory import frame_array
from pipeline.capture.pixels.linear import all_finite
from pipeline.capture.pixels.linear_image import LinearImage, balance
from pipeline.capture.pixels.row_bands import ROWS, LinearReader
from pipeline.capture.pixels.stokes_files import finished
from pipeline.capture.pixels.stokes_frame import apply_stokes_config
from pipeline.capture.radiometry.of_file import factor_of
from pipeline.capture.recognition.one_framing import moves
from pipeline.errors import UserError

LOOKED_AT = 100_000
"""Pixels whose samples are kept to tell noise and movement from."""
MISNAMED = (
    "no Stokes vector explains all angles: check that they are those of the names (swapped files, a filter "
    "not turned, its zero)"
)

TWINS = "two angles are the same picture in every digit: check that the filter was turned, and that no file was copied twice"
OTHER_VIEWS = (
    "what the pictures show is elsewhere from angle to angle: stops of a turntable, or another object? Then say "
    'layout = "photographs" in capture.toml, or give each picture its own view'
)
MIXED = "some angles are 8-bit files, taken as sRGB, and others linear: export all alike"


@dataclass(frozen=True)
class _Angle:
    """One angle's picture: fill(start, stop, rgb [rows, W, 3], invalid [rows, W]) goes through it from top to bottom."""

    path: Path
    image: LinearImage
    size: tuple[int, int]
    fill: Callable[[int, int, NDArray[np.float32], NDArray[np.bool_]], None]
    close: Callable[[], None]
    edges: NDArray[np.float32] | None = None


def read_stack(group: Group, config: CaptureConfig, polariser: PolariserConfig | None) -> DecodedView:
    """The view's Stokes image by weighted least squares; invalid samples are left out. Raises UserError."""
    design = polariser_design([a for a in group.angles if a is not None], polariser.extinction if polariser else None)
    angles: list[_Angle] = []
    try:
        for exposures in group.angles.values():
            angles.append(_open_angle(exposures, config, angles[0] if angles else None, group.view))
            if angles[-1].size != angles[0].size:
                have, want = angles[-1].size, angles[0].size
                raise UserError(angles[-1].path, f"is {have[0]}x{have[1]}, its stack {want[0]}x{want[1]}", "one size a stack")
        stokes, lost, holes, rows = _solve(angles, StackSolver(design))
    finally:
        for angle in angles:
            angle.close()
    balance(stokes, config.radiometry)
    view = DecodedView(stokes=apply_stokes_config(stokes, config.stokes), saturated=lost, design=design)
    view.covariance = design_covariance(design)
    if twins(rows):
        view.faults[TWINS] = 0
    if len(design) > 3:
        view.noise = sample_noise(rows, design)
        if unexplained(rows, design) > OTHER_PICTURES and moves(group.paths):
            view.faults[OTHER_VIEWS] = 0
        elif angles_misfit(rows, design):
            view.faults[MISNAMED] = 0
        elif moved(rows, design):
            view.moved = largest_shift(group, config)
    if holes:
        view.faults["not finite: left out of the fit; check the export"] = holes
    if len({angle.image.encoding for angle in angles}) > 1:
        view.faults[MIXED] = 0
    return finished(view, group.paths[0], angles[0].image, whole=True)


def _solve(
    angles: Sequence[_Angle], solver: StackSolver
) -> tuple[NDArray[np.float32], NDArray[np.bool_] | None, int, NDArray[np.float32]]:
    """(stokes [H, W, 3, 3], where too few angles are left or None, pixels not finite, some rows' samples [n, R, W, 3])."""
    width, height = angles[0].size
    out = frame_array((height, width, 3, 3))
    lost: NDArray[np.bool_] | None = None
    samples = np.empty((len(angles), ROWS, width, 3), np.float32)
    invalid = np.empty((len(angles), ROWS, width), bool)
    step, kept, holes = max(4, width * height // LOOKED_AT), [], 0
    for start in range(0, height, ROWS):
        stop = min(start + ROWS, height)
        rows = stop - start
        band, marks = samples[:, :rows], invalid[:, :rows]
        if rows < ROWS:
            band, marks = np.ascontiguousarray(band), np.ascontiguousarray(marks)
        for k, angle in enumerate(angles):
            angle.fill(start, stop, band[k], marks[k])
        holes += _leave_out_holes(band, marks)
        kept.append(band[:, -start % step :: step].copy())
        flat = out[start:stop].reshape(-1, 3, 3)
        found = solver.solve(band.reshape(len(angles), -1, 3), marks.reshape(len(angles), -1), flat)
        if found is not None:
            lost = np.zeros((height, width), bool) if lost is None else lost
            lost[start:stop] = found.reshape(rows, width)
    return out, lost, holes, np.concatenate(kept, axis=1)


def _leave_out_holes(band: NDArray[np.float32], invalid: NDArray[np.bool_]) -> int:
    """Mark samples [n, rows, W, 3] that are not finite as invalid, with zero in their place; how many pixels have some."""
    if all_finite(band):
        return 0
    bad: NDArray[np.bool_] = np.any(~np.isfinite(band), axis=-1)
    band[bad] = 0
    invalid |= bad
    return int(np.any(bad, axis=0).sum())


def _open_angle(exposures: Sequence[Exposure], config: CaptureConfig, first: _Angle | None, view: str) -> _Angle:
    """A picture read as it is needed, or whole where levels, brackets, camera raw or alignment want it whole."""
    radiometry, path = config.radiometry, exposures[0].path
    whole = len(exposures) > 1 or path.suffix.lower() in RAW_SUFFIXES or radiometry.dark_frame or radiometry.flat_field
    if whole or radiometry.exposure_s or config.stack.align:
        image = read_exposures(exposures, radiometry, view=view)
        rgb, marks = np.ascontiguousarray(image.rgb(path)), image.saturated
        size = (rgb.shape[1], rgb.shape[0])
        edges = edge_strength(rgb) if config.stack.align and first is None else None
        if first is not None and first.edges is not None and size == first.size:
            rgb, marks = registered(first.edges, rgb, marks)

        def copy(start: int, stop: int, out: NDArray[np.float32], invalid: NDArray[np.bool_]) -> None:
            out[...] = rgb[start:stop]
            invalid[...] = marks[start:stop]

        return _Angle(path, image, size, copy, lambda: None, edges)
    reader, factor = LinearReader(path, radiometry, page=exposures[0].page), np.float32(factor_of(radiometry, path))
    facts = LinearImage(np.empty((0, 0, len(reader.names)), np.float32), reader.names, np.empty((0, 0), bool), reader.bits,
                        reader.orientation, reader.exposure_s, reader.encoding, reader.frame)  # fmt: skip

    def fill(start: int, stop: int, out: NDArray[np.float32], invalid: NDArray[np.bool_]) -> None:
        if reader.names == ("R", "G", "B"):
            reader.fill(start, stop, out, invalid)
        else:
            facts.pixels = np.empty((stop - start, reader.size[0], len(reader.names)), np.float32)
            reader.fill(start, stop, facts.pixels, invalid)
            out[...] = facts.rgb(path)
        if factor != 1:
            out *= factor

    return _Angle(path, facts, reader.size, fill, reader.close)
