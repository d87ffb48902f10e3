"""Ground truth is found by a view's name or by its place, and what is no view's is left alone."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pipeline.capture.view_rules import MIN_TRAINING_VIEWS, held_back, too_few_views
from pipeline.errors import UserError
from pipeline.formats.ground_truth import Truth, camera_maps
from pipeline.formats.images import write_exr


def write(path: Path) -> None:
    write_exr(path, {c: np.ones((2, 3)) for c in "XYZ"})


def test_an_image_is_found_by_name_or_by_place(tmp_path: Path) -> None:
    truth = Truth(tmp_path, ("a", "b", "c"))
    for name in ("a", "002", "007", "x"):
        write(tmp_path / "gt" / "normal" / f"{name}.exr")
    names = {view: path.stem if (path := truth.find("normal", view)) else None for view in ("a", "b", "c", "z")}
    assert names == {"a": "a", "b": None, "c": "002", "z": None}
    assert [view for view, _ in truth.images("normal")] == ["c", "a"]
    assert truth.normal("b") is None
    found = truth.normal("a")
    assert found is not None and found.shape == (2, 3, 3)


def test_a_views_own_name_goes_before_its_place(tmp_path: Path) -> None:
    truth = Truth(tmp_path, ("001", "002"))
    for name in ("000", "001"):
        write(tmp_path / "gt" / "normal" / f"{name}.exr")
    found = truth.find("normal", "001")
    assert found is not None and found.stem == "001"


def test_every_file_of_ground_truth_is_listed_and_nothing_else(tmp_path: Path) -> None:
    truth = Truth(tmp_path, ())
    for name in ("gt/mesh.ply", "gt/relight/studio/a.exr", "gt_brdf.json", "cam00/gt/maps.npz", "images/a.exr"):
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(b"{}")
    listed = {str(path.relative_to(tmp_path)) for path in truth.files()}
    assert listed == {"gt/mesh.ply", "gt/relight/studio/a.exr", "gt_brdf.json", "cam00/gt/maps.npz"}
    for damaged in (b"{}", b"", b"PK\x03\x04 cut off"):
        (tmp_path / "cam00/gt/maps.npz").write_bytes(damaged)
        with pytest.raises(UserError, match=r"maps\.npz: (cannot be read|the file is empty)"):
            camera_maps(tmp_path / "cam00")
    assert camera_maps(tmp_path / "cam01") is None


def test_every_eighth_view_in_sorted_order_is_held_back() -> None:
    names = [f"v{k:02d}" for k in range(20)]
    assert held_back(reversed(names)) == {"v00": "test", "v08": "test", "v16": "test"}


def test_a_captures_own_split_goes_before_the_rule() -> None:
    parts = {"a": "train", "b": "validation", "c": "test"}
    assert held_back(["a", "b", "c", "d"], parts) == {"b": "validation", "c": "test"}


def test_too_few_views_are_reported_with_both_numbers() -> None:
    class Views:
        def __init__(self, count: int) -> None:
            self.views = (None,) * count

    few = too_few_views(Views(MIN_TRAINING_VIEWS - 1))  # type: ignore[arg-type]
    assert few == "too few views for a model: 7, at least 8 are needed"
    assert too_few_views(Views(MIN_TRAINING_VIEWS)) is None  # type: ignore[arg-type]
