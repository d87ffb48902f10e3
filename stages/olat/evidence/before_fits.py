"""What the first pixels read tell of the whole capture, before hours are spent on it: a warning, or an error."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline.capture.light_stage.read_light_table import light_table_file
from pipeline.capture.naming.files import count, some
from pipeline.engine.stage import StageRun
from pipeline.errors import UserError
from pipeline.rig.light_table import LightTable
from stages.olat.evidence.frame_order import (
    CLEARLY,
    DOUBTFUL,
    FEWEST,
    NOTED,
    Order,
    as_they_stand,
    fitting_orders,
    lambert,
    light_gains,
)
from stages.olat.evidence.light_frame import (
    FAR,
    SPACING,
    TURNED_RAD,
    WRONG,
    Fit,
    Look,
    find_frame,
    judge,
    peaks,
    spacing,
    spoken,
)
from stages.olat.evidence.light_table_faults import table_faults
from stages.olat.evidence.odd_frames import ambient, odd_lights
from stages.olat.evidence.outline import outward
from stages.olat.evidence.pass_check import compare, pass_faults
from stages.olat.pixel_fit.many_pixels import half_table
from stages.olat.reading.stream import Piece

LOOKED_AT = 300  # pixels: medians over them are known to 6 %
MOST_AWAY = 0.5  # share of normals that face away from the camera above which every map would be wrong
UNEVEN = 0.1  # spread (standard deviation of the logarithm) of the lights' brightnesses worth a line
COLOURED = 0.05  # the same of their colours
BEHIND = -0.25  # cosine below which a light is surely behind the surface


def check_rig(stage: StageRun, rig: LightTable, near: bool) -> None:
    """Tell of a table's own faults. Raises UserError on one that leaves nothing to fit."""
    fault, doubts = table_faults(rig, near)
    table = _table_name(stage)
    if fault:
        raise UserError(table, fault, "give each light its own direction")
    for doubt in doubts:
        stage.warn(f"{table}: {doubt}")


def check_capture(stage: StageRun, pilot: list[Piece], rig: LightTable) -> None:
    """Hold the passes against each other and the frames against the table. Raises UserError on what no fit could survive."""
    config = stage.capture.config.olat
    samples = Seen.of(pilot, rig, config.irradiance, config.specular_factor)
    if samples is None:
        return
    name = pilot[0].job.name
    found = compare(samples.crossed.mean(-1), samples.paralleled.mean(-1))
    stage.note("passes", {k: round(v, 4) for k, v in vars(found).items()})
    fault, doubt = pass_faults(found, pilot[0].job.passes != "both")
    if fault:
        raise UserError(stage.capture.root / name, *fault.split("; ", 1))
    if doubt:
        stage.warn(f"{stage.capture.root / name}: {doubt}")
    if config.near_light:
        return  # directions differ from pixel to pixel
    explanation = explain(samples, rig.directions)
    if explanation is None:
        return
    stage.note("light_frame", explanation.as_json())
    say_frame(stage, explanation, rig.directions, sound_passes=doubt is None)
    if explanation.order.name == "" and explanation.turn is None and doubt is None:
        say_odd_frames(stage, samples.diffuse.mean(-1), rig)
    if explanation.fits and explanation.there.total < WRONG and explanation.order.misfit > NOTED:
        glossy = pilot[0].job.passes in ("parallel", "none")
        say_brightness(stage, explanation.order, samples, rig.directions[explanation.order.lights], glossy)


@dataclass(frozen=True)
class Explanation:
    """How the frames fit the table as it stands (`stands`, `here`), and the order and turn that fit best (`order`, `turn`,
    `there`; the same ones where nothing is clearly better)."""

    stands: Order
    here: Fit
    order: Order
    turn: NDArray[np.float64] | None
    there: Fit

    @property
    def fits(self) -> bool:
        """Whether the diffuse light is explained, so that normals mean something."""
        return self.order.misfit < 2 * DOUBTFUL

    def as_json(self) -> dict[str, object]:
        """For the manifest."""
        figures = {k: None if np.isnan(v) else round(v, 3) for k, v in vars(self.here).items()}
        fits_as = None if self.turn is None else spoken(self.turn)
        return {"misfit": round(self.stands.misfit, 4), **figures, "fits_with": self.order.name or None, "fits_as": fits_as}


def explain(samples: Seen, w: NDArray[np.float64]) -> Explanation | None:
    """What explains the frames under directions w [N, 3] best; None where too few pixels tell."""
    light = samples.diffuse.mean(-1)
    stands, first = as_they_stand(light, w), samples.look(w)
    if stands is None or first is None:
        return None
    here = judge(first, np.eye(3))
    found: list[tuple[Order, NDArray[np.float64] | None, Fit]] = [(stands, None, here)]
    if not (here.total > WRONG or stands.misfit > NOTED):
        return Explanation(stands, here, *found[0])
    looks = [(stands, first)]
    for order in fitting_orders(light, w, stands):
        look = samples.look(w[order.lights])
        if look is not None:
            looks.append((order, look))
            found.append((order, None, judge(look, np.eye(3))))
    for order, look in looks:
        _, turn, fit = find_frame(look)
        if turn is not None:
            found.append((order, turn, fit))
    cost = [fit.total + order.misfit / DOUBTFUL for order, _, fit in found]
    best = int(np.argmin(cost))
    return Explanation(stands, here, *found[best if cost[best] < CLEARLY * cost[0] else 0])


class Seen:
    """Some pixels: crossed, paralleled, diffuse light per irradiance [N, P, 3]; shine [N, P]; rays and outline [P, 3]."""

    def __init__(self, cross: NDArray, parallel: NDArray, view: NDArray, out: NDArray, rig: LightTable, irradiance: float,
                 factor: float) -> None:  # fmt: skip
        energy = (irradiance * rig.intensity)[:, None, None]
        self.crossed, self.paralleled = cross / energy, parallel / energy
        self.diffuse = 2 * np.pi * self.crossed
        self.shine = factor * (self.paralleled - self.crossed).mean(-1)
        self.view, self.outward = view, out

    def look(self, w: NDArray[np.float64]) -> Look | None:
        """Normals, highlights and outline under directions w [N, 3]; None where too few normals are determined."""
        m, each = lambert(self.diffuse.mean(-1), w)
        determined = np.isfinite(each) & (np.linalg.norm(m, axis=1) > 0)
        if determined.sum() < FEWEST:
            return None
        normal = m[determined] / np.linalg.norm(m[determined], axis=1, keepdims=True)
        shine = self.shine[:, determined]
        return Look(normal, self.view[determined], peaks(shine, _noise(shine, w @ normal.T), w), self.outward[determined])

    @classmethod
    def of(cls, pilot: list[Piece], rig: LightTable, irradiance: float, factor: float) -> Seen | None:
        """Pixels spread over the pieces (all of one camera); None where too few of them are lit and finite."""
        job = pilot[0].job
        parts = [piece for piece in pilot if piece.job.name == job.name]
        count = sum(len(piece.samples.band.pixels) for piece in parts)
        step = max(1, count // LOOKED_AT)
        pixels = np.concatenate([piece.samples.band.pixels[::step] for piece in parts])
        cross, parallel = (
            np.concatenate([_floats(getattr(piece.samples, side)[:, ::step]) for piece in parts], 1)
            for side in ("cross", "parallel")
        )
        fine = (np.isfinite(cross) & np.isfinite(parallel)).all((0, 2)) & (parallel.max((0, 2)) > 0)
        if fine.sum() < FEWEST:
            return None
        view = -job.camera.rays_through(pixels[fine])
        return cls(
            cross[:, fine], parallel[:, fine], view, outward(job.mask, job.camera, pixels[fine]), rig, irradiance, factor
        )


def say_frame(stage: StageRun, explanation: Explanation, w: NDArray[np.float64], sound_passes: bool) -> None:
    """A line where frames and table do not belong together. Raises UserError where normals face away from the cameras."""
    table, here = _table_name(stage), explanation.here
    order = explanation.order.name
    remedies = [f"they fit with {order}: number the frames as the table counts its lights"] if order else []
    if explanation.turn is not None:
        remedies.append(
            f"{'' if remedies else 'the table '}fits with its columns x, y, z as {spoken(explanation.turn)}: give directions "
            "from the stage's centre to each light in the world of the cameras"
        )
    turned = "" if np.isnan(here.highlight) else f", highlights lie {np.degrees(here.highlight):.0f} degrees off the normals"
    how = f"misfit {explanation.stands.misfit:.2f}, {100 * here.away:.0f} % of the normals face away from the camera{turned}"
    unknown = "check its frame (the cameras' world) and its order (light k is frame k) against a frame whose light you know"
    if here.away > MOST_AWAY and (explanation.fits if sound_passes else explanation.order.misfit < DOUBTFUL):
        raise UserError(table, f"the light table does not fit the frames ({how})", ", and ".join(remedies) or unknown)
    wrong = not explanation.fits or here.total > FAR or here.highlight > TURNED_RAD + SPACING * spacing(w)
    if remedies or (wrong and sound_passes):
        stage.warn(f"{table}: the light table does not fit the frames ({how}): {', and '.join(remedies) or unknown}")


def say_odd_frames(stage: StageRun, light: NDArray[np.float64], rig: LightTable) -> None:
    """A line for single lights that are not where the table has them, and for light that is in every frame."""
    table, index = _table_name(stage), np.arange(len(rig)) if rig.index is None else rig.index
    if odd := odd_lights(light, rig.directions):
        named = some(str(index[k]) for k in odd)
        stage.warn(
            f"{table}: the frames of {count(odd, 'light')} ({named}) do not fit, while the others do: exchanged, or measured "
            "wrong? Mend these rows, or take them out"
        )
    if share := ambient(light, rig.directions):
        stage.warn(
            f"{stage.capture.root}: every frame holds light ({100 * share:.0f} % of a light's own) whichever light is on: name "
            "a frame without any light as radiometry.dark_frame in capture.toml, or a black_level"
        )


def say_brightness(stage: StageRun, order: Order, samples: Seen, w: NDArray[np.float64], glossy: bool = False) -> None:
    """A line where the frames fit much better with lights w [N, 3] of other brightnesses than the table's.

    glossy: the samples hold highlights, whose own colour tells nothing of the lights'.
    """
    gains = light_gains(samples.diffuse, w)
    logs = np.log(gains)
    common = logs.mean(1)
    uneven, coloured = float(common.std()), float((logs - common[:, None]).std())
    if uneven < UNEVEN and (glossy or coloured < COLOURED):
        return
    _, each = lambert((samples.diffuse / gains[:, None]).mean(-1), w)
    if not np.nanmedian(each) < CLEARLY * order.misfit:
        return
    low, high = (np.exp(v) for v in (common.min(), common.max()))
    colour = ", and their colours differ" if coloured > COLOURED else ""
    stage.warn(
        f"{_table_name(stage)}: the lights are {low:.2f} to {high:.2f} times as bright as the table says{colour}: give them an "
        "intensity column, and divide the frames by each light's colour"
    )


def _noise(shine: NDArray[np.float64], cosine: NDArray[np.float64]) -> NDArray[np.float64]:
    """Deviation [P] of specular samples [N, P]: what is negative betrays it, and what lights behind the surface show."""

    def deviation(chosen: NDArray[np.bool_]) -> NDArray[np.float64]:
        return np.sqrt(np.sum(np.where(chosen, shine, 0) ** 2, 0) / np.maximum(chosen.sum(0), 1))

    return np.maximum(deviation(shine < 0), deviation(cosine < BEHIND))


def _floats(samples: NDArray) -> NDArray[np.float64]:
    return (half_table()[samples] if samples.dtype == np.uint16 else samples).astype(np.float64)


def _table_name(stage: StageRun) -> str:
    """The light table's path, as lines name it."""
    return str(light_table_file(stage.capture.root, stage.capture.config) or stage.capture.root)
