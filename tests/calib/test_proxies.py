"""Pictures for COLMAP lie in folders by number: a camera's name is the capture's, and no path."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from pipeline.formats.images import write_exr
from stages.calib.poses.proxies import write_proxies


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
