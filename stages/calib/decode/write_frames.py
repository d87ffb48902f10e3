"""Views to linear EXR frames, a few at a time, so that reading, conversion and writing overlap."""

from __future__ import annotations

import json
import os
import shutil
from collections import defaultdict
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.capture import DecodedView, ViewSource
from pipeline.capture.naming.files import count, some
from pipeline.engine.stage import StageRun
from pipeline.errors import UserError
from pipeline.formats.images import HALF_MAX, write_exr, write_mask, write_png, write_stokes
from pipeline.geometry.lens import FRAMES
from stages.calib.decode.clip_level import clip_level
from stages.calib.decode.frame_scan_kernel import count_unphysical, make_physical
from stages.calib.decode.light_doubts import FrameRecord, bright_light, doubt_light, polarised_at_all, share_below_zero
from stages.calib.decode.noise import estimate_noise

HALF_FAITHFUL = 2.0**-5
"""A half float keeps 11 bits down to 2^-14; where a frame's brightest sample is above this, the nine bits below it that
an eye or a fit can use stay exact. Dimmer frames are kept as float."""

OVERFLOW = "check stokes.scale, radiometry.white_balance and exposure_s in capture.toml, or export it in other units"

SQUARES = 1e18
"""Radiance whose square single precision still holds: polarised light is compared by squares."""


def decode_views(stage: StageRun) -> None:
    """Decode every view of a multi-view capture. Raises UserError naming the file at fault."""
    capture, output = stage.capture, stage.output
    (output / "frames").mkdir()
    workers = max(1, min(stage.jobs or os.cpu_count() or 1, len(capture.views)))
    records: dict[str, FrameRecord] = {}
    with stage.progress.bar("decoding", len(capture.views), "views") as bar, ThreadPoolExecutor(workers) as pool:
        waiting: set[Future[tuple[str, FrameRecord]]] = set()
        queue = list(reversed(capture.views))
        try:
            while queue or waiting:
                while queue and len(waiting) < workers:  # bounds memory: one frame in flight per worker
                    waiting.add(pool.submit(_decode_one, queue.pop(), stage))
                done, waiting = wait(waiting, return_when=FIRST_COMPLETED)
                for future in done:
                    view, record = future.result()
                    records[view] = record
                    bar.advance()
        except BaseException:
            for future in waiting:
                future.cancel()
            raise
    _tell(stage, records)
    table: dict[str, Any] = {
        "schema": 1,
        "polarisation": capture.polarisation,
        "views": {view: records[view].facts for view in sorted(records)},
    }
    if capture.parts is not None:
        table["parts"] = capture.parts
    (output / FRAMES).write_text(json.dumps(table, indent=1) + "\n", encoding="utf-8")


def _decode_one(source: ViewSource, stage: StageRun) -> tuple[str, FrameRecord]:
    decoded = source.read()
    image = decoded.stokes if decoded.stokes is not None else decoded.rgb
    assert image is not None
    height, width = image.shape[:2]
    record = FrameRecord({}, decoded.faults, pixels=height * width, moved=decoded.moved)
    saturated = _saturated(decoded, source)
    name = f"frames/{source.view}.exr"
    record.below_zero, record.polarised = share_below_zero(decoded.s0), polarised_at_all(decoded.stokes)
    record.bright = bright_light(decoded.s0)
    if decoded.stokes is not None:
        survey = (make_physical if decoded.design is not None else count_unphysical)(decoded.stokes)
        record.negative, record.impossible, peak = survey.negative, survey.impossible, survey.peak
    else:
        peak = float(image.max(initial=0.0))
    if not np.isfinite(peak) or (peak > SQUARES and not np.isfinite(image).all()):
        raise UserError(source.paths[0], "its radiance is more than single precision holds", OVERFLOW)
    record.peak = peak
    record.black = not (peak > 0 and bool((decoded.s0 > 0).any()))  # a NaN is no light
    half = _half(peak, stage.parameters.precision)
    if decoded.verbatim is not None and stage.parameters.precision == "auto":
        shutil.copyfile(decoded.verbatim, stage.output / name)
    elif decoded.stokes is not None:
        write_stokes(stage.output / name, decoded.stokes, half=half, peak=peak)
    else:
        write_exr(stage.output / name, {c: image[..., i] for i, c in enumerate("RGB")}, half=half)
    facts = record.facts
    facts.update(file=name, width=width, height=height, camera=source.camera)
    facts["noise"] = decoded.noise if decoded.noise is not None else estimate_noise(decoded.s0)
    facts["saturated_fraction"] = float(saturated.mean()) if saturated is not None else 0.0
    facts["saturated"] = facts["alpha"] = None
    if saturated is not None and saturated.any():
        facts["saturated"] = f"saturated/{source.view}.png"
        write_mask(stage.output / facts["saturated"], saturated)
    if decoded.alpha is not None:
        facts["alpha"] = f"alpha/{source.view}.png"
        write_png(stage.output / facts["alpha"], decoded.alpha)
    facts["design"] = decoded.design.tolist() if decoded.design is not None else None
    facts["condition"] = float(np.linalg.cond(decoded.design)) if decoded.design is not None else None
    facts["covariance"] = decoded.covariance.tolist() if decoded.covariance is not None else None
    return source.view, record


def _half(peak: float, precision: str) -> bool:
    if precision != "auto":
        return precision == "half"
    return HALF_FAITHFUL <= peak <= HALF_MAX


def _saturated(decoded: DecodedView, source: ViewSource) -> NDArray[np.bool_] | None:
    """What the reader marked, and in float files the plateau that clipping leaves."""
    marked = decoded.saturated
    s0 = decoded.s0
    level = clip_level(s0) if decoded.design is None else None
    if level is None:
        return marked
    plateau: NDArray[np.bool_] = np.any(s0 >= np.float32(level), axis=-1)
    return plateau if marked is None else marked | plateau


def _tell(stage: StageRun, records: dict[str, FrameRecord]) -> None:
    """One line per kind of fault, however many files show it."""
    grouped: dict[str, list[tuple[str, int]]] = defaultdict(list)
    for view, record in sorted(records.items()):
        for fault, pixels in record.faults.items():
            grouped[fault].append((view, pixels))
    for fault, where in grouped.items():
        pixels = sum(n for _, n in where)
        amount = f"{pixels} pixel{'s' * (pixels > 1)} " if pixels else ""
        stage.warn(f"{stage.capture.view(where[0][0]).paths[0]}{_others(where)}: {amount}{fault}")
    moved = {view: r.moved for view, r in sorted(records.items()) if r.moved is not None}
    if moved:
        furthest, path = max(moved.values())
        stage.note("moved_px", {view: round(px, 2) for view, (px, _) in moved.items()})
        stage.warn(
            f"{path}: {furthest:.1f} px off the first picture of its stack"
            + (f", and pictures of {len(moved) - 1} more views" if len(moved) > 1 else "")
            + ": the camera or the object moved between the angles, which makes false polarisation at edges; "
            "stack.align = true in capture.toml registers them"
        )
    total = max(1, sum(r.pixels for r in records.values()))
    negative, impossible = (sum(getattr(r, k) for r in records.values()) for k in ("negative", "impossible"))
    clipped = [v for v, r in sorted(records.items()) if r.facts["saturated_fraction"] > 0]
    stage.note("unphysical", {"negative_s0": negative, "dolp_above_1": impossible, "pixels": total})
    stage.note("saturated_views", len(clipped))
    black = [v for v, r in sorted(records.items()) if r.black]
    if len(black) == len(records):
        raise UserError(
            stage.capture.view(black[0]).paths[0],
            f"every pixel of {'every view' if len(black) > 1 else 'it'} is black or below 0",
            "check the export, the black level and [stokes] scale",
        )
    if black:
        first = stage.capture.view(black[0]).paths[0]
        more = f" and {count(black[1:], 'more view')}" if len(black) > 1 else ""
        stage.warn(f"{first}{more}: every pixel is black: leave it out, or export it again")
    if clipped:
        stage.progress.say(f"saturated samples in {count(clipped, 'view')} ({some(clipped)})")
    doubt_light(stage, list(records.values()))
    sizes = {(r.facts["width"], r.facts["height"]) for r in records.values()}
    if len(sizes) > 1:
        stage.warn(
            f"{stage.capture.root}: images of {len(sizes)} sizes ({some(f'{w}x{h}' for w, h in sorted(sizes))}); "
            "each keeps its own camera; check that none is a smaller copy"
        )
    worst = max((r.facts["condition"] or 0.0 for r in records.values()), default=0.0)
    if worst > REFUSE_CONDITION:
        view = next(v for v, r in sorted(records.items()) if (r.facts["condition"] or 0) == worst)
        raise UserError(
            stage.capture.view(view).paths[0],
            f"polariser angles too close together (condition number {worst:.0f})",
            "spread them: 0, 45, 90, 135",
        )
    if worst > WARN_CONDITION:
        close = f"polariser angles close together (condition number {worst:.0f}): s1 and s2 are noisy"
        stage.warn(f"{stage.capture.root}: {close}; check the angles in file names or [stack.angles_deg]")


WARN_CONDITION, REFUSE_CONDITION = 30.0, 300.0
"""Of the polariser design: 2.4 for 0/45/90°, 81 for 0/1°, 810 for 0/0.1°."""


def _others(where: list[tuple[str, int]]) -> str:
    return f" and {len(where) - 1} more" if len(where) > 1 else ""
