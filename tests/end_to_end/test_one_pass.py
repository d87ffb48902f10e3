"""A photometric-stereo folder as labs publish them, without polarisers and cameras: through every stage with no hand edit."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from pipeline.formats.images import XYZ, read_image
from synth.ball import write
from synth.olat_pixels import rig_of

from .conftest import polarfield

pytestmark = pytest.mark.slow
SIZE, LIGHTS, ALBEDO, SHARP, SPECULAR = 40, 30, (0.5, 0.35, 0.2), 40, 0.6


def sphere() -> tuple[np.ndarray, np.ndarray]:
    """Normals [H, W, 3] (x right, y up, z to the camera) of a sphere seen from far away, and where it is."""
    rows, columns = np.indices((SIZE, SIZE)) + 0.5
    x, y = (columns - SIZE / 2) / (0.42 * SIZE), -(rows - SIZE / 2) / (0.42 * SIZE)
    square = x * x + y * y
    return np.stack([x, y, np.sqrt(np.maximum(1 - square, 0))], -1), square < 0.96


def write_folder(root: Path) -> np.ndarray:
    """16-bit pictures under one light each with the tables beside them; returns the normals."""
    normal, on = sphere()
    lights = rig_of(2 * LIGHTS).directions
    lights = lights[lights[:, 2] > 0.25][:LIGHTS]
    colours = np.random.default_rng(0).uniform(0.7, 1.3, (len(lights), 3))
    names = [f"{k:03d}.png" for k in range(1, len(lights) + 1)]
    for name, light, colour in zip(names, lights, colours):
        half = light + np.array([0.0, 0, 1])
        half /= np.linalg.norm(half)
        shade = np.maximum(normal @ light, 0)[..., None] * ALBEDO
        shade = shade + SPECULAR * (np.maximum(normal @ half, 0) ** SHARP)[..., None]
        write(root / name, (np.clip(0.6 * on[..., None] * shade * colour, 0, 1) * 65535 + 0.5).astype(np.uint16))
    write(root / "mask.png", (on * 255).astype(np.uint8))
    for name, rows in (("light_directions.txt", lights), ("light_intensities.txt", colours)):
        (root / name).write_text("\n".join(" ".join(f"{v:.6f}" for v in row) for row in rows) + "\n")
    (root / "filenames.txt").write_text("\n".join(names) + "\n")
    return normal * on[..., None]


def test_pictures_under_one_light_each_go_from_decode_to_the_report(tmp_path):
    normal = write_folder(tmp_path / "ball")
    outcome = polarfield("all", tmp_path / "ball", "--dataset", tmp_path / "ds", "--envs", "neutral_studio")
    assert outcome.status == 0 and "warning" not in outcome.err + outcome.out, outcome.err
    maps = tmp_path / "ds" / "olat" / "current" / "cam00"
    found, on = read_image(maps / "normal.exr", XYZ), normal.any(-1)
    error = np.degrees(np.arccos(np.clip((found * normal).sum(-1), -1, 1)))[on]
    assert np.median(error) < 0.5 and np.quantile(error, 0.9) < 3
    colour = np.median(read_image(maps / "diffuse_albedo.exr")[on], 0)
    np.testing.assert_allclose(colour / colour.mean(), np.array(ALBEDO) / np.mean(ALBEDO), rtol=0.02)
    relit = tmp_path / "ds" / "relight" / "current" / "neutral_studio"
    frames, rendered = (read_image(relit / f"cam00{kind}.exr")[on] for kind in ("_olat", ""))
    assert np.corrcoef(frames.ravel(), rendered.ravel())[0, 1] > 0.9  # half a dome's lights stand for all of the map in the sum
    metrics = json.loads((tmp_path / "ds" / "metrics" / "current" / "metrics.json").read_text())
    assert metrics["olat"]["residual_median"] < 0.1 and (tmp_path / "ds/metrics/current/report.html").stat().st_size > 10_000
