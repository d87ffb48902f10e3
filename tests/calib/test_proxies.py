"""Pictures for COLMAP lie in folders by number: a camera's name is the capture's, and no path."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from pipeline.formats.images import read_mask, write_exr, write_png
from stages.calib.poses.proxies import Proxy, write_masks, write_proxies


@pytest.mark.parametrize("names", [("A", "B"), ("../../outside", "/"), ("<b>", "a\0b")])
def test_no_camera_name_becomes_a_path(tmp_path, names):
    outside = tmp_path / "outside"
    outside.mkdir()
    names = [name.replace("/", f"{outside}/x", 1) if name == "/" else name for name in names]
    decode, frames = tmp_path / "dataset" / "decode", {}
    for k, camera in enumerate(names):
        for view in range(2):
            file = f"frames/{k}{view}.exr"
            write_exr(decode / file, {c: np.full((4, 6), 0.3, np.float32) for c in "RGB"})
            frames[f"{k}{view}"] = {"file": file, "width": 6, "height": 4, "camera": camera}
    stage = SimpleNamespace(capture=SimpleNamespace(polarisation="none"), inputs={"decode": decode}, jobs=1)
    work = tmp_path / "dataset" / "work"
    proxies = write_proxies(stage, work, frames)  # type: ignore[arg-type]
    assert {p.group for p in proxies} == {"000_6x4", "001_6x4"} and list(outside.iterdir()) == []
    assert all((work / p.name).resolve().is_relative_to(work.resolve()) and (work / p.name).is_file() for p in proxies)


def test_features_are_kept_in_masks_of_small_values(tmp_path):
    inside = np.zeros((4, 6), bool)
    inside[1:3, 2:5] = True
    write_png(tmp_path / "a.png", inside.astype(np.uint8))
    capture, parameters = SimpleNamespace(masks={"a": tmp_path / "a.png"}), SimpleNamespace(use_masks=True)
    stage = SimpleNamespace(capture=capture, parameters=parameters)
    folder = write_masks(stage, tmp_path / "masks", [Proxy("a", "000_6x4/a.tif", "000_6x4", "", 6, 4)])  # type: ignore[arg-type]
    assert folder is not None
    np.testing.assert_array_equal(read_mask(folder / "000_6x4/a.tif.png"), inside)
