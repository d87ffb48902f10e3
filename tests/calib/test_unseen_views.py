"""A view whose mask is empty, edge-on or beside the object, is left out with a word; the others go on."""

import json

import numpy as np
import pytest

from pipeline.errors import UserError
from pipeline.formats.images import read_mask, write_mask, write_png, write_stokes
from pipeline.geometry.cameras import Camera, frame_of


def capture(root, masks):
    frames = []
    for k, mask in enumerate(masks):
        pose = np.eye(4)
        pose[0, 3] = 0.1 * k
        s0 = np.linspace(0.2, 0.6, mask.size * 3, dtype=np.float32).reshape(*mask.shape, 1, 3)
        write_stokes(root / f"images/{k}.exr", np.concatenate([s0, 0.1 * s0, 0 * s0], 2))
        (write_mask if mask.dtype == bool else write_png)(root / f"masks/{k}.png", mask)
        frames.append({"file_path": f"images/{k}.exr", **frame_of(Camera(24, 20, 30.0, 30.0, 12.0, 10.0, pose))})
    (root / "transforms.json").write_text(json.dumps({"frames": frames}))


def test_empty_and_edge_on_masks_leave_their_views_out(run_stages, tmp_path):
    object_mask = np.zeros((20, 24), bool)
    object_mask[5:15, 6:18] = True
    thin = np.zeros((20, 24), np.uint8)
    thin[:, 12] = range(70, 90)  # a plate of a third of a pixel
    masks = [object_mask] * 8
    masks[3], masks[5] = np.zeros_like(object_mask), thin
    capture(tmp_path / "c", masks)
    runs = run_stages(tmp_path / "c", tmp_path / "d", "decode", "poses", "masks", masks={"hull_check": False})
    (line,) = [w for w in runs["masks"].warnings if "mask is empty" in w]
    assert "2 views (3, 5)" in line and "\n" not in line
    table = json.loads((runs["masks"].output / "masks.json").read_text())["views"]
    assert [v for v in table if "left_out" in table[v]] == ["3", "5"]
    assert not read_mask(runs["masks"].output / "5.png").any()
    from stages.train.views.data import load_sources

    outputs = [runs[n].output for n in ("decode", "poses", "masks")]
    splits = {s.name: s.split for s in load_sources(*outputs, "auto")[0]}
    assert splits == {"0": "test", **{str(k): "train" for k in (1, 2, 4, 6, 7)}, "3": "left_out", "5": "left_out"}


def test_a_capture_whose_masks_are_all_empty_is_refused(run_stages, tmp_path):
    capture(tmp_path / "c", [np.zeros((20, 24), bool)] * 4)
    with pytest.raises(UserError, match="no view shows the object"):
        run_stages(tmp_path / "c", tmp_path / "d", "decode", "poses", "masks")
