"""How an object moved, between two passes or during one: shift, turn and what they leave are measured and told."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from pipeline.capture.model import LightStageCamera
from pipeline.formats.images import write_exr
from pipeline.geometry.cameras import Camera
from stages.olat.parameters import OlatParameters
from stages.olat.reading import stream
from stages.olat.reading.movement import movement_between
from stages.olat.reading.rig_cameras import CameraJob
from stages.olat.reading.scanline_bands import bands_of
from stages.olat.reading.tracking_frames import movement_during

HEIGHT, WIDTH = 120, 104
MIDDLE = np.array([HEIGHT / 2, WIDTH / 2])


def blobs(turn_deg: float = 0.0, down: float = 0.0, right: float = 0.0, parallax: float = 0.0) -> np.ndarray:
    """Texture, turned counter-clockwise as displayed about its middle and shifted; parallax: one half's further shift."""
    rng = np.random.default_rng(4)
    grid = np.stack(np.indices((HEIGHT, WIDTH)).astype(float), -1)
    c, s = np.cos(np.radians(turn_deg)), np.sin(np.radians(turn_deg))
    shift = np.array([down, right]) + parallax * (grid[..., 1:] > WIDTH / 2) * np.array([0.0, 1.0])
    places = (grid - MIDDLE - shift) @ np.array([[c, -s], [s, c]]) + MIDDLE  # where the picture comes from
    out = np.full((HEIGHT, WIDTH), 0.2)
    for row, column in rng.uniform(6, 100, (160, 2)):
        out += rng.uniform(0.3, 1.0) * np.exp(-((places - [row, column]) ** 2).sum(-1) / 6)
    return out


def disc(radius: float = 48.0) -> np.ndarray:
    return ((np.stack(np.indices((HEIGHT, WIDTH)), -1) - MIDDLE) ** 2).sum(-1) < radius**2


@pytest.mark.parametrize(("turn", "down", "right"), [(0, 0, 0), (0, 1.5, -2), (1.5, 0, 0), (-2.0, 1.0, 0.5)])
def test_shift_and_turn_are_measured(turn, down, right):
    found = movement_between(blobs(), blobs(turn, down, right), disc())
    assert found is not None
    assert np.allclose([found.right, found.down], [right, down], atol=0.25) and abs(found.turn_deg - turn) < 0.3
    assert found.turned == (turn != 0) and found.residual_px < 0.35
    assert found.furthest_px == pytest.approx(np.hypot(right, down) + np.radians(abs(turn)) * 48, abs=0.6)


def test_what_no_turn_explains_is_left():
    still, bent = (movement_between(blobs(), blobs(parallax=p), disc()) for p in (0.0, 2.0))
    assert still is not None and bent is not None and still.residual_px < 0.1 and bent.residual_px > 0.5


def test_pictures_that_have_nothing_in_common_tell_nothing():
    other = np.random.default_rng(0).uniform(0.2, 1, (HEIGHT, WIDTH))
    assert movement_between(blobs(), other, disc()) is None
    assert movement_between(blobs(), blobs(), np.zeros((HEIGHT, WIDTH), bool)) is None


def test_tracking_frames_tell_how_the_object_moved_during_a_pass(tmp_path):
    def frame(number: int, image: np.ndarray):
        path = tmp_path / f"{number:06d}.exr"
        write_exr(path, dict.fromkeys("RGB", (image * disc(50)).astype(np.float32)), half=True)
        return path

    lights = tuple(frame(k, 0.1 * blobs()) for k in range(2, 6))
    dark = 0.001 * blobs()
    full = (frame(0, dark), frame(1, blobs()), frame(6, blobs(1.0, 0.0, 2.0)), frame(7, dark))
    camera = Camera(WIDTH, HEIGHT, 100.0, 100.0, WIDTH / 2, HEIGHT / 2, np.eye(4))
    found = movement_during(LightStageCamera("cam00", lights, lights, None, camera, full), disc())
    assert found is not None and found.right == pytest.approx(2, abs=0.25) and found.turn_deg == pytest.approx(1, abs=0.3)
    alone = LightStageCamera("cam00", lights, lights, None, camera, full[:2])
    assert movement_during(alone, disc()) is None


def test_a_turned_pass_is_read_back_into_place(tmp_path):
    mask = disc(46)
    paths = {name: [tmp_path / name / f"{k:06d}.exr" for k in range(8)] for name in ("cross", "parallel")}
    for name, image in (("cross", blobs()), ("parallel", blobs(-2.5, 1.0, -2.0))):
        for k, path in enumerate(paths[name]):
            write_exr(path, dict.fromkeys("RGB", ((1 + 0.1 * k) * image).astype(np.float32)), half=True)
    camera = Camera(WIDTH, HEIGHT, 100.0, 100.0, WIDTH / 2, HEIGHT / 2, np.eye(4))
    job = CameraJob("cam00", paths["cross"], paths["parallel"], camera, mask, True, bands_of(mask, 8, 1e3, 2))
    stage = SimpleNamespace(parameters=OlatParameters())
    (piece,) = stream._pieces(stage, [job], True)
    undone = piece.undone
    assert undone.turn is not None and -np.degrees(undone.turn.radians) == pytest.approx(-2.5, abs=0.3)
    assert np.allclose([undone.right, undone.down], [-2, 1], atol=0.3)
    cross, parallel = (side.view(np.float16).astype(float) for side in (piece.samples.cross, piece.samples.parallel))
    plain = blobs(-2.5, 1.0, -2.0).reshape(-1, 1)[piece.samples.band.pixels]
    before = np.abs(plain - cross[0]).mean()
    assert np.abs(parallel[0] - cross[0]).mean() < 0.25 * before  # what rounding to whole pixels leaves
