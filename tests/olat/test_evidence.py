"""A light stage tells of its own faults: lights in another frame or order, passes that do not belong together, poor tables."""

import warnings
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from pipeline.errors import UserError
from pipeline.rig.light_table import LightTable
from pipeline.rig.map_flags import AWAY, NO_LOBE
from pipeline.rig.solid_angles import fibonacci_sphere
from stages.olat.evidence.after_fits import Verdict
from stages.olat.evidence.before_fits import Seen, explain, say_brightness, say_frame
from stages.olat.evidence.frame_order import lambert
from stages.olat.evidence.light_frame import spoken, surrounded, turns
from stages.olat.evidence.light_table_faults import table_faults
from stages.olat.evidence.odd_frames import ambient, odd_lights
from stages.olat.evidence.pass_check import compare, pass_faults
from stages.olat.pixel_fit.result_layout import FLAG, RESIDUAL, WIDTH

VIEW = np.array([0.1, 0.2, 1.0]) / np.linalg.norm([0.1, 0.2, 1.0])
RNG = np.random.default_rng(4)


def scattered(count: int = 50) -> np.ndarray:
    """Lights all around in no order, unlike a spiral that looks the same when it is turned."""
    return RNG.permutation(fibonacci_sphere(count))


LIGHTS = scattered()


def dome(degrees: float, axis: np.ndarray) -> np.ndarray:
    """60 lights within this angle of an axis."""
    all_around = fibonacci_sphere(4000)
    return RNG.permutation(all_around[all_around @ axis > np.cos(np.radians(degrees))])[:60]


def ball(
    noise: float = 0.0, shine: float = 0.05, lights: np.ndarray = LIGHTS
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Crossed, parallel samples [N, P, 3], view and outline [P, 3] of a ball under lights [N, 3], seen along VIEW."""
    n = fibonacci_sphere(700)
    n = n[n @ VIEW > 0.1]
    flat = n - VIEW * (n @ VIEW)[:, None]
    rim = (n @ VIEW < 0.35)[:, None]
    out = np.where(rim, flat / np.linalg.norm(flat, axis=1, keepdims=True), 0.0)
    cosine = np.clip(lights @ n.T, 0, None)
    h = lights + VIEW
    h /= np.linalg.norm(h, axis=1, keepdims=True)
    z = np.clip(h @ n.T, 1e-3, 1)
    lobe = shine * np.exp(-(1 / z**2 - 1) / 0.3**2) / (4 * np.pi * 0.3**2 * z**4) * (cosine > 0)
    cross = 0.5 * cosine[..., None] * [0.5, 0.35, 0.2]
    parallel = cross + lobe[..., None]
    grain = noise * cross.max()
    cross, parallel = (x + grain * RNG.normal(size=x.shape) for x in (cross, parallel))
    return cross, parallel, np.tile(VIEW, (len(n), 1)), out


class Told(SimpleNamespace):
    """A stage that keeps what it is told."""

    def warn(self, line):
        self.lines.append(line)


def judged(directions: np.ndarray, samples=None) -> list[str]:
    """The lines that frames under this light table give; a refusal starts with 'refused'."""
    cross, parallel, view, out = samples or ball()
    rig = LightTable(directions, directions, np.ones(len(directions)), None)
    seen = Seen(cross, parallel, view, out, rig, np.pi, 2.0)
    found = explain(seen, directions)
    config = SimpleNamespace(olat=SimpleNamespace(lights="lights.csv"))
    stage = Told(lines=[], capture=SimpleNamespace(root=Path("capture"), config=config))
    assert found is not None
    try:
        say_frame(stage, found, directions, sound_passes=True)
    except UserError as error:
        return [f"refused {error}"]
    say_brightness(stage, found.order, seen, directions[found.order.lights])
    return stage.lines


@pytest.mark.parametrize("noise", [0.0, 0.01, 0.03])
def test_a_sound_stage_is_not_doubted(noise):
    assert judged(LIGHTS, ball(noise)) == []


def test_a_sound_stage_without_highlights_is_not_doubted():
    assert judged(LIGHTS, ball(shine=0.0)) == []


@pytest.mark.slow
@pytest.mark.parametrize("axis", [VIEW, np.array([0.0, 1, 0])], ids=["before", "above"])
@pytest.mark.parametrize("degrees", [30, 60, 90])
@pytest.mark.parametrize("noise, shine", [(0.0, 0.05), (0.01, 0.05), (0.003, 0.0), (0.03, 0.0)])
def test_a_sound_dome_is_not_doubted_for_highlights_beyond_its_edge(degrees, axis, noise, shine):
    lights = dome(degrees, axis)
    assert judged(lights, ball(noise, shine, lights)) == []


def test_a_turned_dome_is_named_by_the_highlights_within_it():
    lights = dome(90, VIEW)
    c, s = np.cos(0.52), np.sin(0.52)
    (line,) = judged(lights @ np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]]), ball(lights=lights))
    assert "highlights lie" in line


def test_lights_at_the_edge_of_a_dome_are_not_surrounded():
    lights = fibonacci_sphere(240)
    lights = lights[lights @ VIEW > 0.5]
    inner = surrounded(lights)
    assert inner[lights @ VIEW > np.cos(np.radians(40))].all() and not inner[lights @ VIEW < np.cos(np.radians(58))].any()
    assert surrounded(fibonacci_sphere(346)).all()


def test_pixels_without_crossed_light_are_passed_over():
    light = np.clip(LIGHTS @ fibonacci_sphere(60).T, 0, None)
    light[:, ::3] = 0
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        _, misfit = lambert(light, LIGHTS)
    assert np.isnan(misfit[::3]).all() and np.nanmax(misfit) < 1e-6


@pytest.mark.slow
@pytest.mark.parametrize("turn", list(turns())[1:], ids=spoken)
def test_every_exchange_and_sign_of_axes_is_named(turn):
    (line,) = judged(LIGHTS @ turn)
    assert spoken(turn) in line


@pytest.mark.parametrize("turn", [np.diag([-1.0, 1, 1]), np.diag([1.0, 1, -1]), -np.eye(3)], ids=spoken)
def test_a_matte_object_tells_by_its_outline_and_by_facing_away(turn):
    (line,) = judged(LIGHTS @ turn, ball(shine=0.0))
    assert spoken(turn) in line


def test_normals_that_face_away_from_the_camera_are_refused():
    (line,) = judged(-LIGHTS)
    assert line.startswith("refused") and "face away" in line


@pytest.mark.parametrize("shift", [1, -1, 2, -2, 3])
def test_missing_and_extra_frames_are_counted(shift):
    (line,) = judged(np.roll(LIGHTS, shift, 0))  # line k of the table is light k - shift: frame k shows line k + shift
    assert f"light k{shift:+d} for frame k" in line


def test_a_reversed_table_is_named():
    (line,) = judged(LIGHTS[::-1])
    assert "reversed" in line


def test_lights_in_no_order_are_reported():
    lines = judged(np.random.default_rng(0).permutation(LIGHTS))
    assert len(lines) == 1 and "does not fit" in lines[0]


def test_a_table_turned_by_thirty_degrees_is_reported():
    c, s = np.cos(0.52), np.sin(0.52)
    lines = judged(LIGHTS @ np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]]))
    assert len(lines) == 1 and "highlights lie" in lines[0]


@pytest.mark.parametrize("colours, words", [(1, "as bright as the table says:"), (3, "colours differ")])
def test_lights_of_other_brightness_or_colour_are_reported(colours, words):
    gains = np.exp(0.3 * np.random.default_rng(1).normal(size=(len(LIGHTS), 1, colours)))
    cross, parallel, view, out = ball()
    (line,) = judged(LIGHTS, (cross * gains, parallel * gains, view, out))
    assert words in line


def passes(change) -> tuple[str | None, str | None]:
    cross, parallel, _, _ = ball()
    return pass_faults(compare(*(x.mean(-1) for x in change(cross, parallel))))


def test_sound_passes_say_nothing():
    assert passes(lambda c, p: (c, p)) == (None, None)


@pytest.mark.parametrize(
    "change, words",
    [
        (lambda c, p: (p, c), "exchange the folders"),
        (lambda c, p: (c, 0.5 * p), "one exposure"),
        (lambda c, p: (0 * c + c.mean(0), 0 * p + p.mean(0)), "no light changes the frames"),
    ],
)
def test_passes_that_no_fit_survives_are_refused(change, words):
    fault, doubt = passes(change)
    assert fault is not None and words in fault and doubt is None


@pytest.mark.parametrize(
    "change, words",
    [
        (lambda c, p: (p, p), "are equal"),
        (lambda c, p: (c, p[::-1]), "in the reverse order"),
        (lambda c, p: (c, np.roll(p, 7, 0)), "another order"),
        (lambda c, p: (0.5 * c, p), "2.00 times the crossed one even away from highlights"),
    ],
)
def test_passes_in_doubt_are_reported(change, words):
    fault, doubt = passes(change)
    assert fault is None and doubt is not None and words in doubt


def test_directions_that_are_taken_for_places_are_doubted():
    unit = LightTable(LIGHTS, LIGHTS, np.ones(len(LIGHTS)), None)
    assert table_faults(unit, near=False)[1] == [] and "1 world unit" in table_faults(unit, near=True)[1][0]
    assert table_faults(table(LIGHTS), near=True)[1] == []


def test_single_lights_that_are_not_where_the_table_has_them_are_named():
    light = 2 * np.pi * ball()[0].mean(-1)
    noisy = light * (1 + 0.03 * np.random.default_rng(2).normal(size=light.shape))
    first, *others = np.argsort(-light.mean(1))[:20]
    second = min(others, key=lambda k: LIGHTS[k] @ LIGHTS[first])
    swapped, mirrored = LIGHTS.copy(), LIGHTS.copy()
    swapped[[first, second]] = swapped[[second, first]]
    mirrored[first] *= -1
    assert odd_lights(noisy, LIGHTS) == []
    assert odd_lights(noisy, swapped) == sorted([first, second]) and odd_lights(noisy, mirrored) == [first]


@pytest.mark.parametrize(("everywhere", "found"), [(0.0, False), (0.01, False), (0.1, True)])
def test_light_that_is_in_every_frame_is_measured(everywhere, found):
    light = ball()[0].mean(-1)
    level = np.linalg.norm(lambert(light, LIGHTS)[0], axis=1)
    share = ambient(light + everywhere * level, LIGHTS)
    assert (share == pytest.approx(everywhere, rel=0.4)) if found else share == 0


def table(directions) -> LightTable:
    d = np.asarray(directions, float)
    d = d / np.linalg.norm(d, axis=1, keepdims=True)
    return LightTable(d, 3 * d, np.ones(len(d)), None)


def test_light_tables_tell_of_repeated_narrow_and_flat_lights():
    assert table_faults(table(LIGHTS), False) == (None, [])
    assert table_faults(table(LIGHTS[LIGHTS[:, 2] > 0]), False) == (None, [])  # a dome
    fault, _ = table_faults(table(np.tile([0.0, 0.0, 1.0], (9, 1))), False)
    assert fault is not None and "one direction" in fault
    _, (repeated,) = table_faults(table([*LIGHTS[:-1], LIGHTS[3]]), False)
    assert "4 and 50" in repeated
    _, (narrow,) = table_faults(table(np.c_[0.1 * LIGHTS[:, :2], np.ones(50)]), False)
    assert "close together" in narrow
    _, (flat,) = table_faults(table(np.c_[LIGHTS[:, :2], np.zeros(50)]), False)
    assert "one plane" in flat


@pytest.mark.parametrize("flag, words", [(AWAY, "another frame"), (NO_LOBE, "exchanged, equal")])
def test_maps_that_are_mostly_flagged_are_reported(flag, words):
    rows = np.zeros((100, WIDTH))
    rows[:60, FLAG] = flag
    stage = Told(lines=[], note=lambda key, value: None)
    verdict = Verdict()
    verdict.add(rows)
    verdict.tell(stage, "cam00")
    assert len(stage.lines) == 1 and words in stage.lines[0]
    stage.lines.clear()
    verdict.tell(stage, "cam00", lobe=False)  # of one pass nobody asks a lobe
    assert bool(stage.lines) == (flag == AWAY)
    stage.lines.clear()
    rows[:60, FLAG], rows[:, RESIDUAL] = 0, 0.7
    verdict = Verdict()
    verdict.add(rows)
    stage.lines.clear()
    verdict.tell(stage, "cam00")
    assert verdict.misfit == pytest.approx(0.7, abs=0.01) and "70 %" in stage.lines[0]
