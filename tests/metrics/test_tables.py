"""Tables from files: what is compared with what, and what is null where the capture cannot tell."""

from __future__ import annotations

import json

import numpy as np
import pytest

from pipeline.formats.gbuffer import CHANNELS, SurfaceImage, channels_of
from pipeline.formats.ground_truth import Truth
from pipeline.formats.images import write_exr, write_png, write_rgb, write_stokes
from stages.metrics.olat_figures import olat_table
from stages.metrics.train_figures import train_table
from synth.environments import meadow

SIZE = 24


@pytest.fixture
def scene(tmp_path):
    """A trained view that equals what was measured: Stokes image, normals, mask, environment, material."""
    rng = np.random.default_rng(2)
    y, x = (np.mgrid[:SIZE, :SIZE] + 0.5) / SIZE * 2 - 1
    inside = np.hypot(x, y) < 0.8
    normal = np.stack([x, -y, np.sqrt(np.maximum(1 - x * x - y * y, 0.1))], -1)
    normal = normal / np.linalg.norm(normal, axis=-1, keepdims=True) * inside[..., None]
    s0 = (0.2 + 0.5 * rng.random((SIZE, SIZE, 3))) * inside[..., None]
    stokes = np.stack([s0, 0.2 * s0, 0.1 * s0], 2).astype(np.float32)
    channels = {f"S{k}.{c}": stokes[:, :, k, i] for k in range(3) for i, c in enumerate("RGB")}
    material = np.concatenate([0.3 * inside[..., None] * [1, 1, 1], inside[..., None] * [0.4, 1.5]], -1)
    channels |= channels_of(SurfaceImage(normal.astype(np.float32), material, inside * 1.0, inside * 3.0))
    capture = tmp_path / "capture"
    write_exr(tmp_path / "train" / "test" / "a.exr", channels)
    write_rgb(tmp_path / "train" / "env.exr", meadow(32))
    (tmp_path / "train" / "polarisers.json").write_text(
        json.dumps({"camA": {"angle_deg": 30.0, "std_deg": 0.1, "trusted": False}})
    )
    write_png(tmp_path / "masks" / "a.png", inside.astype(np.uint8) * 255)
    write_stokes(tmp_path / "decode" / "frames" / "a.exr", stokes)
    (capture / "gt").mkdir(parents=True)
    return tmp_path, capture, stokes, normal


def table_of(root, capture, frames):
    return train_table(root / "train", root / "decode", root / "masks", Truth(capture, ("a",)), frames)


def test_perfect_model_has_perfect_figures(scene):
    root, capture, _, normal = scene
    write_exr(capture / "gt" / "normal" / "a.exr", {c: normal[..., k] for k, c in enumerate("XYZ")})
    write_rgb(capture / "gt" / "env.hdr", meadow(32))
    (capture / "gt" / "material.json").write_text(json.dumps({"alpha": 0.16, "ior": 1.4}))
    figures = table_of(root, capture, {"polarisation": "stokes"}).as_json()
    assert figures["psnr_srgb"] == figures["psnr_foreground"] == 120
    assert figures["normal_mae_deg"] == pytest.approx(0, abs=1e-3)
    assert figures["dolp_mae"] == pytest.approx(0, abs=1e-6)
    assert figures["roughness_error"] == pytest.approx(0, abs=1e-6)
    assert figures["ior_error"] == pytest.approx(0.1, abs=1e-6)
    assert figures["env_psnr"] > 35  # RGBE's rounding


def test_truth_is_also_found_by_the_views_place(scene):
    root, capture, _, normal = scene
    write_exr(capture / "gt" / "normal" / "000.exr", {c: -normal[..., k] for k, c in enumerate("XYZ")})
    assert table_of(root, capture, {"polarisation": "stokes"}).figures["normal_mae_deg"] == pytest.approx(180, abs=1e-3)


def test_without_truth_figures_are_null_and_say_why(scene):
    root, capture, _, _ = scene
    figures = table_of(root, capture, {"polarisation": "stokes"}).as_json()
    for name in ("normal_mae_deg", "env_psnr", "ior_error", "polariser_error_deg"):
        assert figures[name] is None
        assert "gt/" in figures["why"][name]
    assert figures["psnr_srgb"] == 120


def test_background_of_a_photograph_does_not_count(scene):
    root, capture, stokes, _ = scene
    outside = stokes[:, :, 0].max(-1) == 0
    cluttered = stokes.copy()
    cluttered[outside] = 0.9
    write_stokes(root / "decode" / "frames" / "a.exr", cluttered)
    assert table_of(root, capture, {"polarisation": "stokes"}).figures["psnr_srgb"] == 120


def test_rim_outside_the_mask_counts_on_a_black_backdrop(scene):
    root, capture, stokes, _ = scene
    inside = stokes[:, :, 0].max(-1) > 0
    smaller = inside & np.roll(inside, 1, 0) & np.roll(inside, -1, 0) & np.roll(inside, 1, 1) & np.roll(inside, -1, 1)
    write_png(root / "masks" / "a.png", smaller.astype(np.uint8) * 255)
    assert table_of(root, capture, {"polarisation": "stokes"}).figures["psnr_srgb"] == 120
    cut = stokes * smaller[..., None, None]  # a model that lacks the rim is told so
    write_exr(root / "train" / "test" / "a.exr", {
        **{f"S{k}.{c}": cut[:, :, k, i] for k in range(3) for i, c in enumerate("RGB")},
        **{k: inside * 1.0 for k in CHANNELS},
    })  # fmt: skip
    assert table_of(root, capture, {"polarisation": "stokes"}).figures["psnr_srgb"] < 40


def test_behind_a_polariser_the_measured_intensity_is_compared(scene):
    root, capture, stokes, _ = scene
    t = 2 * np.radians(30.0)
    seen = 0.5 * (stokes[:, :, 0] + np.cos(t) * stokes[:, :, 1] + np.sin(t) * stokes[:, :, 2])
    write_rgb(root / "decode" / "frames" / "a.exr", seen)
    (capture / "gt" / "polarisers.json").write_text(json.dumps({"camA": 178.0, "camB": 5.0}))
    frames = {"polarisation": "polarisers", "views": {"a": {"camera": "camA"}}}
    figures = table_of(root, capture, frames).as_json()
    assert figures["psnr_srgb_behind_polariser"] > 100
    assert figures["psnr_srgb"] is None and "polarisers" in figures["why"]["psnr_srgb"]
    assert figures["polariser_error_deg"] == {"camA": pytest.approx(32), "camB": None}


def test_light_stage_normals_and_albedo_against_their_maps(tmp_path):
    rng = np.random.default_rng(0)
    normal = np.zeros((SIZE, SIZE, 3), np.float32)
    normal[..., 2] = 1
    albedo = (0.3 + 0.5 * rng.random((SIZE, SIZE, 3))).astype(np.float32)
    mask = np.ones((SIZE, SIZE), np.float32)
    folder = tmp_path / "olat" / "cam00"
    tilt = np.radians(3.0)
    tilted = normal @ np.array([[1, 0, 0], [0, np.cos(tilt), np.sin(tilt)], [0, -np.sin(tilt), np.cos(tilt)]])
    for name, image in (("diffuse_normal", tilted), ("specular_normal", -normal), ("normal", normal), ("tangent", normal)):
        write_exr(folder / f"{name}.exr", {c: image[..., k] for k, c in enumerate("XYZ")})
    write_exr(folder / "diffuse_albedo.exr", {c: 1.1 * albedo[..., k] for k, c in enumerate("RGB")})
    write_exr(folder / "specular_albedo.exr", {"Y": 0.4 * mask})
    write_exr(folder / "sigma.exr", {"X": 0.33 * mask, "Y": 0.3 * mask})
    write_exr(folder / "residual.exr", {"Y": 0.02 * mask, "flag": 0 * mask})
    write_exr(folder / "occlusion_d.exr", {"Y": 0.7 * mask})
    truth = tmp_path / "capture" / "cam00" / "gt"
    truth.mkdir(parents=True)
    np.savez(truth / "maps.npz", normal=normal, mask=mask, albedo=albedo, dp_du=np.roll(normal, 1, -1))
    (tmp_path / "capture" / "gt_brdf.json").write_text(json.dumps({"sigma": [0.3, 0.3]}))
    out = olat_table(tmp_path / "olat", Truth(tmp_path / "capture", ())).as_json()
    camera = out["cam00"]
    assert camera["diffuse_normal"]["median"] == pytest.approx(3, abs=1e-3)
    assert camera["specular_normal"]["p90"] == pytest.approx(180, abs=1e-3)
    assert camera["albedo_rel_median"] == pytest.approx(0.1, abs=1e-5)
    assert camera["sigma_rel_error"] == pytest.approx([0.1, 0.0], abs=1e-5)
    assert out["views"][0]["normal_median_deg"] == pytest.approx(0, abs=1e-4)
    assert camera["sigma_map_rel_median"] == pytest.approx([0.1, 0.0], abs=1e-5)
    assert camera["specular_albedo_rel_median"] is None and camera["occlusion_error"] is None
    assert "gt_brdf.json" in camera["why"]["specular_albedo_rel_median"]
    widths = np.stack([0.33 * mask, 0.5 * mask], -1)  # along u and v: the larger is v
    own = {"specular_albedo": 0.5 * mask, "sigma": widths, "occlusion": 0.9 * mask}
    np.savez(truth / "maps.npz", normal=normal, mask=mask, albedo=albedo, **own)
    told = olat_table(tmp_path / "olat", Truth(tmp_path / "capture", ())).as_json()["cam00"]
    assert told["specular_albedo_rel_median"] == pytest.approx(0.2, abs=1e-5)
    assert told["sigma_map_rel_median"] == pytest.approx([0.17 / 0.5, 0.03 / 0.33], abs=1e-5)
    assert told["occlusion_error"] == pytest.approx(0.2, abs=1e-6)
    (truth / "maps.npz").unlink()
    blind = olat_table(tmp_path / "olat", Truth(tmp_path / "capture", ())).as_json()["cam00"]
    assert blind["normal"] is None and "maps.npz" in blind["why"]["normal"]
    assert blind["residual_median"] == pytest.approx(0.02, abs=1e-5)
