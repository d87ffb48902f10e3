"""What is in use survives the loss of links or of in_use.json, and collection keeps what it cannot judge."""

from __future__ import annotations

import json
import os
import shutil
from pathlib import Path

import pytest

STAGES = ("count", "double", "relight", "metrics")


def recorded(dataset: Path = Path("d")) -> dict[str, str]:
    table = json.loads((dataset / "in_use.json").read_text())
    assert table.pop("schema") == 1
    return table


def versions(dataset: Path = Path("d")) -> set[str]:
    return {f"{p.parent.name}/{p.name}" for p in dataset.glob("[a-z]*/*") if p.is_dir() and p.name != "current"}


def unlink_all(dataset: Path) -> None:
    for stage in STAGES:
        (dataset / stage / "current").unlink()


def as_folders(dataset: Path) -> None:
    """What `cp -rL` and `rsync -rL` make of links."""
    for stage in STAGES:
        link = dataset / stage / "current"
        key = os.readlink(link)
        link.unlink()
        shutil.copytree(dataset / stage / key, link)


def as_folders_alone(dataset: Path) -> None:
    """Only what the links named was copied."""
    for stage in STAGES:
        link = dataset / stage / "current"
        key = os.readlink(link)
        link.unlink()
        (dataset / stage / key).rename(link)


def as_text(dataset: Path) -> None:
    """What some zip programs and file systems make of links."""
    for stage in STAGES:
        link = dataset / stage / "current"
        key = os.readlink(link)
        link.unlink()
        link.write_text(key)


def without_file(dataset: Path) -> None:
    (dataset / "in_use.json").unlink()


def without_work(dataset: Path) -> None:
    """What skips names that begin with a dot."""
    shutil.rmtree(dataset / ".work")
    unlink_all(dataset)


@pytest.fixture
def finished(command, capture) -> dict[str, str]:
    """A finished dataset d with older versions beside; what is in use of it."""
    command("all", capture.root, "--dataset", "d", "--params", "count.factor=3")
    command("all", capture.root, "--dataset", "d")
    return {stage: os.readlink(f"d/{stage}/current") for stage in STAGES}


def test_the_file_and_the_links_tell_the_same(finished):
    assert recorded() == finished


@pytest.mark.slow
@pytest.mark.parametrize("lose", [unlink_all, as_folders, as_text, without_file, without_work])
def test_a_copied_dataset_keeps_its_results_through_collection_and_runs(command, finished, lose):
    lose(Path("d"))
    before = versions()
    assert "all is done" in command("plan", "--dataset", "d").out
    collected = command("gc", "--dataset", "d", "--yes")
    assert collected.status == 0 and {f"{s}/{k}" for s, k in finished.items()} == versions() < before
    again = command("all", "--dataset", "d")
    assert again.status == 0 and again.ran == [] and recorded() == finished
    assert {stage: os.readlink(f"d/{stage}/current") for stage in STAGES} == finished


def test_versions_that_were_copied_alone_are_found_again(command, finished):
    as_folders_alone(Path("d"))
    assert "all is done" in command("plan", "--dataset", "d").out
    assert command("all", "--dataset", "d").ran == []
    assert {stage: os.readlink(f"d/{stage}/current") for stage in STAGES} == finished


def test_a_folder_in_place_of_a_link_that_is_no_copy_is_kept_beside(command, finished):
    link = Path("d/count/current")
    link.unlink()
    link.mkdir()
    (link / "notes.txt").write_text("mine")
    assert command("all", "--dataset", "d").status == 0
    assert os.readlink(link) == finished["count"] and Path("d/count/current-kept-1/notes.txt").read_text() == "mine"


def test_collection_keeps_all_of_what_nothing_tells(command, finished):
    unlink_all(Path("d"))
    without_file(Path("d"))
    before = versions()
    collected = command("gc", "--dataset", "d", "--yes")
    assert collected.status == 0 and versions() == before and "nothing tells which version is in use" in collected.out
    assert command("all", "--dataset", "d").ran == []
    assert "4 folders" in command("gc", "--dataset", "d", "--yes").out


def test_collection_keeps_all_that_a_damaged_version_in_use_may_have_been_made_from(command, finished):
    Path(f"d/double/{finished['double']}/manifest.json").write_text("{")
    before = {v for v in versions() if v.startswith(("count/", "never/"))}
    collected = command("gc", "--dataset", "d", "--yes")
    assert before <= versions() and f"double/{finished['double']}" in versions() and "cannot be read" in collected.out


def test_collection_off_a_terminal_lists_removes_nothing_and_says_how(command, finished):
    before = versions()
    collected = command("gc", "--dataset", "d")
    assert collected.status == 0 and versions() == before
    assert "can go: d/count/" in collected.out and "YES=1" in collected.out


def test_without_symbolic_links_everything_works(command, capture, monkeypatch):
    def refuse(self, target):
        raise PermissionError(1, "Operation not permitted", str(self))

    monkeypatch.setattr(Path, "symlink_to", refuse)
    made = command("all", capture.root, "--dataset", "d")
    assert made.status == 0 and not list(Path("d").glob("*/current"))
    assert made.out.splitlines()[-1] == f"report: d/metrics/{recorded()['metrics']}/report.html"
    assert command("all", "--dataset", "d").ran == []
    assert command("all", "--dataset", "d", "--params", "count.factor=5").ran == ["count", "double", "relight", "metrics"]
    assert command("double", "--dataset", "d").status == 0
    assert "4 folders" in command("gc", "--dataset", "d", "--yes").out and command("verify", "--dataset", "d").status == 0


def test_a_key_that_is_a_path_is_not_followed(command, finished, tmp_path):
    (tmp_path / "outside").mkdir()
    link = Path("d/count/current")
    link.unlink()
    link.symlink_to("../../outside")
    table = {"schema": 1, "count": "../../outside", "double": 7, "metrics": None}
    Path("d/in_use.json").write_text(json.dumps(table))
    assert command("all", "--dataset", "d").ran == [] and recorded() == finished
    assert os.readlink(link) == finished["count"] and list((tmp_path / "outside").iterdir()) == []
