"""Lights told from a ball in view: its outline, its highlight or its shading, whatever the camera's field of view."""

from __future__ import annotations

import numpy as np
import pytest

from pipeline.formats.images import write_png, write_rgb
from pipeline.rig.ball_calibration import ball_normals, calibrated, outline_circle
from pipeline.rig.lsx3_and_csv_light_tables import read_lights_csv
from stages.calib.decode.ball_lights import main

RADIUS, SIZE = 40.0, 128
LIGHT_RADIUS = np.radians(3.0)


def lights(count: int = 12) -> np.ndarray:
    """Directions over the hemisphere about the camera's, and a little behind the ball's rim."""
    k = np.arange(count) + 0.5
    height, turn = 1 - 1.1 * k / count, k * 2.39996
    across = np.sqrt(1 - height**2)
    return np.stack([across * np.cos(turn), across * np.sin(turn), height], -1)


def sphere(focal: float | None, fine: int = 4):
    """Normals, views and coverage of the ball seen by `fine` x `fine` rays a pixel, off the frame's middle."""
    if focal is None:
        circle, principal = (60.3 * fine, 66.8 * fine, RADIUS * fine), None
        normal, view, _ = ball_normals((SIZE * fine, SIZE * fine), circle, None, None)
        rows, columns = np.indices((SIZE * fine, SIZE * fine)) + 0.5
        on = np.hypot(columns - circle[0], rows - circle[1]) < circle[2]
        return normal, view, on, principal
    principal = (SIZE / 2, SIZE / 2)
    rows, columns = np.indices((SIZE * fine, SIZE * fine)) + 0.5
    ray = np.stack([(columns / fine - SIZE / 2) / focal, -(rows / fine - SIZE / 2) / focal, -np.ones(rows.shape)], -1)
    ray /= np.linalg.norm(ray, axis=-1, keepdims=True)
    centre = np.array([-0.1, -0.08, -focal / RADIUS])
    along = ray @ centre
    root = along**2 - (centre @ centre - 1)
    on = root > 0
    return ray * (along - np.sqrt(np.maximum(root, 0)))[..., None] - centre, -ray, on, principal


def means(image: np.ndarray, fine: int = 4) -> np.ndarray:
    return image.reshape(SIZE, fine, SIZE, fine, -1).mean((1, 3))


@pytest.mark.parametrize("focal", [None, 400.0])
@pytest.mark.parametrize("kind", ["mirror", "matte"])
def test_directions_and_intensities_come_back(kind, focal):
    """To 1 degree and 3 % on a ball of 40 pixels' radius, with half a percent of noise."""
    rng = np.random.default_rng(0)
    normal, view, on, principal = sphere(focal)
    true = lights(12) if kind == "mirror" else lights(12)[:9]
    colours = rng.uniform(0.5, 1.5, (len(true), 3))
    frames = []
    for light, colour in zip(true, colours):
        if kind == "mirror":
            mirrored = 2 * (normal * view).sum(-1, keepdims=True) * normal - view
            shade = ((mirrored * light).sum(-1) > np.cos(LIGHT_RADIUS)) / (LIGHT_RADIUS**2) + 0.02
        else:
            shade = np.maximum((normal * light).sum(-1), 0)
        frame = means((on * shade)[..., None] * colour)
        frames.append(frame + 0.005 * rng.normal(size=frame.shape))
    found = calibrated(frames, means(on[..., None].astype(float))[..., 0], kind, focal, principal)
    error = np.degrees(np.arccos(np.clip((found.directions * true).sum(1), -1, 1)))
    near = true[:, 2] > -0.05 if kind == "mirror" else np.ones(len(true), bool)  # a mirrored light behind the ball is a smear
    assert found.seen[near].all() and np.median(error[near]) < 0.5 and error[near].max() < 1.5
    ratio = found.colours / colours
    off = np.abs(ratio / np.median(ratio[near]) - 1)[near]
    assert np.median(off) < 0.03


def test_the_residual_says_how_far_directions_are_off():
    rng = np.random.default_rng(1)
    normal, _, on, _ = sphere(None)
    light = np.array([0.3, 0.4, np.sqrt(0.75)])
    clean = means((on * np.maximum((normal * light).sum(-1), 0))[..., None] * np.ones(3))
    mask = means(on[..., None].astype(float))[..., 0]
    frames = [clean + 0.2 * rng.normal(size=clean.shape) for _ in range(40)]
    found = calibrated(frames, mask, "matte")
    error = np.degrees(np.arccos(np.clip(found.directions @ light, -1, 1)))
    true = np.sqrt(np.mean(error**2))
    assert true / 2 < np.median(found.residual_deg) < 2 * true


def test_a_frame_without_light_is_said_to_show_none():
    mask = np.zeros((32, 32))
    rows, columns = np.indices(mask.shape)
    mask[np.hypot(rows - 16, columns - 16) < 10] = 1
    for kind in ("mirror", "matte"):
        assert not calibrated([np.zeros((32, 32, 3))], mask, kind).seen[0]
    with pytest.raises(ValueError, match="empty"):
        outline_circle(np.zeros((4, 4)))


def test_the_command_writes_a_table_that_the_reader_takes(tmp_path, capsys):
    normal, _, on, _ = sphere(None, 1)
    true = lights(9)[:5]
    for k, light in enumerate(true):
        frame = ((on * np.maximum((normal * light).sum(-1), 0))[..., None] * [0.5, 1.0, 0.8]).astype(np.float32)
        write_rgb(tmp_path / "frames" / f"{k:03d}.exr", frame)
    write_png(tmp_path / "ball.png", on.astype(np.float32))
    out = tmp_path / "lights.csv"
    assert main([str(tmp_path / "frames"), "--mask", str(tmp_path / "ball.png"), "--kind", "matte", "-o", str(out)]) == 0
    assert "5 of 5 lights, residual 0.0" in capsys.readouterr().out
    table = read_lights_csv(out)
    assert np.degrees(np.arccos(np.clip((table.directions * true).sum(1), -1, 1))).max() < 1
    np.testing.assert_allclose(table.colour, np.tile([0.5, 1.0, 0.8], (5, 1)) / np.mean([0.5, 1.0, 0.8]), rtol=0.01)
    assert main([str(tmp_path / "frames"), "--mask", str(tmp_path / "none.png")]) == 2
    assert main([str(tmp_path / "frames"), "--kind", "matte", "-o", str(out)]) == 0  # the ball found by itself
    assert "ball: centre (60." in capsys.readouterr().out
    again = read_lights_csv(out)
    assert np.degrees(np.arccos(np.clip((again.directions * true).sum(1), -1, 1))).max() < 1


def test_a_ball_that_is_not_there_is_asked_for(tmp_path, capsys):
    for k in range(3):
        write_rgb(tmp_path / f"{k:03d}.exr", np.random.default_rng(k).uniform(size=(64, 64, 3)).astype(np.float32))
    assert main([str(tmp_path), "-o", str(tmp_path / "out.csv")]) == 2
    assert "give --mask" in capsys.readouterr().err and not (tmp_path / "out.csv").exists()
