"""A dataset that was handed over: a file that no stage leaves is named in one line, though its manifest vouches for it."""

from __future__ import annotations

import dataclasses
import json
import re
from pathlib import Path

import numpy as np
import pytest

from pipeline.engine import cli
from pipeline.engine.dataset import Dataset
from pipeline.engine.dataset.digests import digest_file
from pipeline.engine.dataset.documents import sealed
from pipeline.formats.images import write_exr

FRAMES = {"views": {"0": {"width": 4, "height": 4, "camera": "camera", "file": "frames/0.exr"}}}


@pytest.fixture
def house(stages, command) -> dict:
    """Stages of which count leaves frames.json and a picture, and double reads the picture's first pixel."""
    house = cli.load_stages({})
    count, double = house["count"].run, house["double"].run

    def with_frames(run):
        count(run)
        (run.output / "frames.json").write_text(json.dumps(FRAMES))
        (run.output / "frames").mkdir()
        write_exr(run.output / "frames" / "0.exr", {"Y": np.ones((4, 4), np.float32)})

    def reading(run):
        from pipeline.formats.images import read_exr

        np.ones((4, 4)) + read_exr(run.inputs["count"] / "frames" / "0.exr")["Y"]
        double(run)

    house["count"] = dataclasses.replace(house["count"], run=with_frames)
    house["double"] = dataclasses.replace(house["double"], run=reading)
    return house


def forge(name: str, make) -> None:
    """Change a file of count's version, and what its manifest says of it."""
    version = Dataset(Path("d")).current("count")
    assert version is not None
    make(version.folder / name)
    manifest = json.loads((version.folder / "manifest.json").read_text())
    for output in manifest["outputs"]:
        path = version.folder / output["path"]
        output.update(bytes=path.stat().st_size, digest=digest_file(path))
    (version.folder / "manifest.json").write_text(sealed(manifest))


@pytest.mark.parametrize(
    ("name", "make", "said"),
    [
        ("frames.json", lambda p: p.write_text('{"views": 3}'), r"frames.json: is one whose views is no table: no stage wrote"),
        (
            "frames/0.exr",
            lambda p: write_exr(p, {"Y": np.ones((3, 4), np.float32)}),
            r"0.exr: is 4x3, its view 4x4 .ValueError",
        ),
    ],
)
def test_what_no_stage_leaves_is_named(command, capture, house, name, make, said):
    assert command("count", capture.root, "--dataset", "d").status == 0
    forge(name, make)
    assert command("verify", "--dataset", "d").status == 0  # digests agree
    stopped = command("all", capture.root, "--dataset", "d")
    assert stopped.status == 2 and stopped.err.count("polarfield:") == 1 and re.search(said, stopped.err), stopped.text


def test_a_fault_of_the_program_on_sound_inputs_stays_a_fault_of_the_program(command, capture, house):
    def broken(run):
        raise ZeroDivisionError

    house["double"] = dataclasses.replace(house["double"], run=broken)
    with pytest.raises(ZeroDivisionError):
        command("all", capture.root, "--dataset", "d")


def test_an_export_that_fails_on_a_forged_file_names_it(command, capture, house, monkeypatch):
    from pipeline.engine.inputs_check import explained
    from pipeline.errors import UserError

    assert command("count", capture.root, "--dataset", "d").status == 0
    dataset = Dataset(Path("d"))
    with pytest.raises(KeyError), explained(dataset, house):
        raise KeyError
    forge("frames/0.exr", lambda p: write_exr(p, {"Y": np.full((4, 4), np.nan, np.float32)}))
    with pytest.raises(UserError, match=r"0\.exr: holds pixels that are no numbers"), explained(dataset, house):
        raise KeyError
