"""Material maps against their truth, and holes: what counts, and what a constant factor may not hide or cost."""

import numpy as np
import pytest

from pipeline.errors import UserError
from pipeline.formats.gbuffer import SurfaceImage
from pipeline.formats.images import write_exr
from stages.metrics import lpips_distance
from stages.metrics.material_figures import CHANNELS, holes_pct, material_figures
from stages.metrics.part_figures import part_figures

SIZE = 20


def surface(albedo=0.4, roughness=0.3, ior=1.5):
    material = np.zeros((SIZE, SIZE, 5), np.float32)
    material[..., :3], material[..., 3], material[..., 4] = albedo, roughness, ior
    plain = np.ones((SIZE, SIZE), np.float32)
    return SurfaceImage(np.zeros((SIZE, SIZE, 3), np.float32), material, plain, plain)


def truth(path, albedo=0.5, roughness=0.4, ior=1.6, empty=0):
    maps = np.zeros((SIZE, SIZE, 5), np.float32)
    maps[:, empty:, :3], maps[:, empty:, 3], maps[:, empty:, 4] = albedo, roughness, ior
    write_exr(path, {c: maps[..., k] for k, c in enumerate(CHANNELS)})
    return path


def test_albedo_is_relative_roughness_and_index_are_absolute(tmp_path):
    found = material_figures(truth(tmp_path / "a.exr"), surface(), np.ones((SIZE, SIZE), bool))
    assert found == pytest.approx(
        {"albedo_rel_error": 0.2, "albedo_rel_error_scaled": 0, "roughness_map_error": 0.1, "ior_map_error": 0.1}, abs=1e-6
    )


def test_pixels_at_the_edge_of_the_truth_or_outside_the_object_do_not_count(tmp_path):
    model = surface()
    model.material[:, :9, 3] = 0.9  # of the truth's first two columns, and of where there is none
    path = truth(tmp_path / "a.exr", empty=7)
    assert material_figures(path, model, np.ones((SIZE, SIZE), bool))["roughness_map_error"] == pytest.approx(0.1, abs=1e-6)
    assert material_figures(path, model, np.zeros((SIZE, SIZE), bool)) == {}


def test_a_black_albedo_is_measured_against_the_darkest(tmp_path):
    found = material_figures(truth(tmp_path / "a.exr", albedo=0.0), surface(albedo=0.01), np.ones((SIZE, SIZE), bool))
    assert found["albedo_rel_error"] == pytest.approx(0.5)
    assert found["albedo_rel_error_scaled"] == pytest.approx(0.0)


def test_truth_of_another_size_gives_no_figure_and_one_without_a_channel_is_named(tmp_path):
    assert material_figures(truth(tmp_path / "a.exr"), surface(), np.ones((SIZE, SIZE + 1), bool)) == {}
    write_exr(tmp_path / "b.exr", {"albedo.R": np.ones((SIZE, SIZE), np.float32)})
    with pytest.raises(UserError, match=r"b\.exr"):
        material_figures(tmp_path / "b.exr", surface(), np.ones((SIZE, SIZE), bool))


def test_holes_are_the_share_of_covered_pixels_that_let_most_light_through():
    alpha, inside = np.ones((SIZE, SIZE), np.float32), np.zeros((SIZE, SIZE), bool)
    inside[:10], alpha[:2], alpha[15:] = True, 0.4, 0.0
    assert holes_pct(alpha, inside) == pytest.approx(20.0)


def test_parts_are_compared_as_they_are_shown_where_the_truth_holds_them(tmp_path):
    from skimage.metrics import peak_signal_noise_ratio

    from pipeline.formats.images import srgb_encode

    rng = np.random.default_rng(3)
    model, true = (rng.random((SIZE, SIZE, 3)).astype(np.float32) for _ in range(2))
    channels = {f"{part}.{c}": model[..., k] for part in ("diffuse", "specular") for k, c in enumerate("RGB")}
    write_exr(tmp_path / "a.exr", {f"diffuse.{c}": true[..., k] for k, c in enumerate("RGB")})
    inside = np.zeros((SIZE, SIZE), bool)
    inside[4:12] = True
    found = part_figures(tmp_path / "a.exr", channels, inside)
    theirs = peak_signal_noise_ratio(srgb_encode(true[4:12]), srgb_encode(model[4:12]), data_range=1.0)
    assert found == pytest.approx({"psnr_diffuse": theirs}, abs=1e-4)
    assert part_figures(tmp_path / "a.exr", channels, inside[:-1]) == {}


def test_without_its_weights_lpips_is_left_out_and_says_why(monkeypatch, tmp_path):
    monkeypatch.setenv("TORCH_HOME", str(tmp_path))
    assert lpips_distance.lpips(np.zeros((40, 40, 3)), np.ones((40, 40, 3))) is None
    monkeypatch.setattr(lpips_distance.importlib.util, "find_spec", lambda name: True)
    assert str(tmp_path) in lpips_distance.missing() and lpips_distance.WEIGHTS in lpips_distance.missing()
