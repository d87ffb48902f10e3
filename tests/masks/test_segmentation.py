"""Segmentation without given masks: by all views together, by a clean plate, by a matte, by a SAM checkpoint."""

import io

import numpy as np
import pytest

from pipeline.errors import UserError
from pipeline.formats.ply import write_ply


def iou(a, b):
    return (a & b).sum() / (a | b).sum()


@pytest.mark.slow
def test_object_before_a_busy_background_is_found_from_all_views(views):
    from stages.masks.background import segment

    masks = segment(views.images, views.cameras, {}, 480)
    scores = [iou(m, t) for m, t in zip(masks, views.masks)]
    assert np.mean(scores) > 0.95 and min(scores) > 0.9  # measured 0.97 and 0.94


@pytest.mark.slow
def test_segmentation_is_repeatable(views):
    from stages.masks.background import segment

    some = (views.images[:6], views.cameras[:6], {}, 96)
    for a, b in zip(segment(*some), segment(*some)):
        np.testing.assert_array_equal(a, b)


def test_parallel_cameras_look_at_nothing(views):
    from stages.masks.background import segment

    same = [views.cameras[0]] * 5
    assert segment(views.images[:5], same, {}, 96) is None


def test_clean_plate_finds_the_object_and_forgives_exposure(views):
    from stages.masks.clean_plate import difference_mask

    mask = difference_mask(views.images[0] * np.float32(1.1), views.plates[0])
    assert iou(mask, views.masks[0]) > 0.95


def test_clean_plate_leaves_a_shadow_out():
    from stages.masks.clean_plate import difference_mask

    rng = np.random.default_rng(0)
    plate = np.tile(np.float32([0.2, 0.4, 0.1]), (60, 80, 1)) * rng.uniform(0.9, 1.1, (60, 80, 1)).astype(np.float32)
    image = plate.copy()
    image[40:55, 10:70] *= 0.7
    image[10:40, 30:50] = [0.5, 0.1, 0.1]
    mask = difference_mask(image, plate)
    assert mask[12:38, 32:48].all() and not mask[42:53, 12:68].any()


def test_matte_keeps_holes_and_thin_parts():
    from stages.masks.matte import matte

    truth = np.zeros((80, 60), bool)
    truth[20:60, 15:45] = True
    truth[30:40, 25:35] = False
    truth[10:20, 29:31] = True
    image = np.where(truth, 0.3, 0.01) + np.random.default_rng(0).normal(0, 0.003, truth.shape)
    np.testing.assert_array_equal(matte(image), truth)


def test_tidy_drops_specks_only():
    from stages.masks.background import tidy

    mask = np.zeros((100, 100), bool)
    mask[20:80, 20:80] = True
    mask[50:54, 50:54] = False  # a real hole of 16 px
    noisy = mask.copy()
    noisy[5, 5], noisy[30, 30] = True, False
    np.testing.assert_array_equal(tidy(noisy), mask)


def test_hull_check_blames_the_mask_that_lost_a_part_and_the_one_with_too_much(views):
    from stages.masks.hull_check import check_masks_agree

    assert not any(a.suspicious for a in check_masks_agree(views.masks, views.cameras))
    cut = [m.copy() for m in views.masks]
    rows = np.flatnonzero(cut[3].any(1))
    cut[3][: rows[len(rows) // 3]] = False
    assert [i for i, a in enumerate(check_masks_agree(cut, views.cameras)) if a.suspicious] == [3]
    swollen = [m.copy() for m in views.masks]
    swollen[8][:20] = True
    agreement = check_masks_agree(swollen, views.cameras)
    assert max(range(len(agreement)), key=lambda i: agreement[i].excess) == 8 and agreement[8].suspicious


@pytest.mark.slow
def test_sam_checkpoint_from_a_local_folder(views, tmp_path):
    import torch
    from transformers import SamConfig, SamModel, SamVisionConfig

    from stages.masks.sam import load_sam, prompt_points, segment_image

    torch.manual_seed(0)
    vision = SamVisionConfig(hidden_size=16, output_channels=16, num_hidden_layers=1, num_attention_heads=2, image_size=64,
                             patch_size=16, mlp_dim=16, num_pos_feats=8, global_attn_indexes=[0], window_size=2)  # fmt: skip
    prompt = {"hidden_size": 16, "image_size": 64, "patch_size": 16, "image_embedding_size": 4, "mask_input_channels": 4}
    decoder = {"hidden_size": 16, "num_attention_heads": 2, "mlp_dim": 16, "num_hidden_layers": 1, "iou_head_hidden_dim": 16}
    SamModel(SamConfig(vision_config=vision, prompt_encoder_config=prompt, mask_decoder_config=decoder)).save_pretrained(
        tmp_path
    )
    model = load_sam(tmp_path)
    image = (np.clip(views.images[0], 0, 1) * 255).astype(np.uint8)[:70]
    points = prompt_points(None, None, None, 96, 70)
    by_point = segment_image(model, image, points, None)
    by_box = segment_image(model, image, None, np.array([10.0, 10.0, 60.0, 60.0]))
    assert by_point.shape == by_box.shape == (70, 96)
    np.testing.assert_array_equal(by_point, segment_image(load_sam(tmp_path), image, points, None))


@pytest.mark.parametrize("prompt", ["points", "box"])
def test_sam_is_prompted_by_the_sparse_model(views, tmp_path, monkeypatch, prompt):
    from types import SimpleNamespace

    from pipeline.engine.progress import Progress
    from stages.masks import sam

    rng = np.random.default_rng(0)
    direction = rng.normal(size=(300, 3))
    cloud = 0.55 * direction / np.linalg.norm(direction, axis=-1, keepdims=True)  # on the largest sphere of the object
    cloud[:9] = rng.normal(size=(9, 3)) * 40  # background
    write_ply(tmp_path / "points.ply", dict(zip("xyz", cloud.T)))
    asked = {}

    def segment(model, image, points, box):
        asked[len(asked)] = points, box
        return np.ones(image.shape[:2], bool)

    monkeypatch.setattr(sam, "load_sam", lambda folder: None)
    monkeypatch.setattr(sam, "frame_s0", lambda stage, view: views.images[int(view)])
    monkeypatch.setattr(sam, "segment_image", segment)
    parameters = SimpleNamespace(sam_checkpoint="", prompt=prompt)
    stage = SimpleNamespace(parameters=parameters, inputs={"poses": tmp_path}, progress=Progress(io.StringIO()))
    sam.by_sam(stage, ["0", "3", "7"], {str(i): c for i, c in enumerate(views.cameras)})
    for (points, box), index in zip(asked.values(), (0, 3, 7)):
        mask = views.masks[index]
        if prompt == "points":
            assert box is None and len(points) == sam.POINTS
            assert mask[points[:, 1].astype(int), points[:, 0].astype(int)].all()
        else:
            x0, y0, x1, y1 = box
            pixels, _ = views.cameras[index].project(cloud[9:])
            inside = (pixels > [x0, y0]).all(-1) & (pixels < [x1, y1]).all(-1)
            assert points is None and inside.mean() > 0.95 and (x1 - x0) * (y1 - y0) < 2 * mask.sum()


@pytest.mark.slow
def test_missing_sam_checkpoint_is_a_user_error(tmp_path):
    from stages.masks.sam import load_sam

    with pytest.raises(UserError, match=r"config\.json"):
        load_sam(tmp_path)
