"""Nothing outside a dataset is written or deleted, whatever links and names a handed-over dataset holds."""

from __future__ import annotations

import json
import os
from pathlib import Path

import pytest

from pipeline.engine.dataset import Dataset
from pipeline.errors import UserError


@pytest.fixture
def precious(tmp_path) -> Path:
    """A folder outside, with a file and what looks like a version."""
    folder = tmp_path / "precious"
    (folder / "0123456789abcdef").mkdir(parents=True)
    (folder / "0123456789abcdef" / "data").write_text("keep")
    (folder / "file").write_text("keep")
    return folder


def untouched(folder: Path) -> bool:
    return sorted(p.name for p in folder.rglob("*")) == ["0123456789abcdef", "data", "file"] and all(
        p.read_text() == "keep" for p in folder.rglob("*") if p.is_file()
    )


def test_a_lock_that_is_a_link_is_refused_and_its_target_kept(command, refused, capture, precious):
    command("all", capture.root, "--dataset", "d")
    key = os.readlink("d/count/current")
    Path(f"d/count/{key}/count.txt").unlink()
    lock = Path(f"d/.work/count/{key}.lock")
    lock.unlink(missing_ok=True)
    lock.symlink_to(precious / "file")
    again = command("all", "--dataset", "d")
    assert again.status == 2 and f"{key}.lock" in again.err and "Traceback" not in again.text
    for name in ("in_use.lock", "in_use_file.lock"):
        Path(f"d/.work/{name}").unlink()
        Path(f"d/.work/{name}").symlink_to(precious / "file")
    assert "in_use.lock" in refused("all", "--dataset", "d") and "in_use.lock" in refused("gc", "--dataset", "d", "--yes")
    assert untouched(precious)


@pytest.mark.parametrize("place", ["count", ".work/count", ".work"])
def test_linked_folders_are_refused(command, refused, capture, precious, place):
    command("all", capture.root, "--dataset", "d")
    folder = Path("d") / place
    folder.rename("aside")
    folder.symlink_to(precious)
    for arguments in (("gc", "--dataset", "d", "--yes"), ("gc", "--dataset", "d", "--dry-run")):
        if place != ".work" or "--yes" in arguments:
            assert "is a link" in refused(*arguments)
    (capture.root / "number.txt").write_text("5")
    again = command("all", "--dataset", "d")
    assert again.status == 2 and "is a link" in again.err and "Traceback" not in again.text
    assert untouched(precious)


@pytest.mark.parametrize("place", ["", "output", "scratch", "scratch/deep", "usage.new", "usage.json"])
def test_links_in_unfinished_work_are_not_followed(command, capture, precious, place):
    command("all", capture.root, "--dataset", "d")
    key = os.readlink("d/count/current")
    (Path("d/count") / key).rename("aside")
    link = Path("d/.work/count") / key / place
    link.parent.mkdir(parents=True, exist_ok=True)
    link.symlink_to(precious if "." not in place else precious / "file")
    again = command("all", "--dataset", "d")
    assert again.status == 0 if place else again.status == 2 and "is a link" in again.err
    assert untouched(precious)


def test_a_version_or_small_file_that_is_a_link_is_replaced_not_written_through(command, capture, precious):
    command("all", capture.root, "--dataset", "d")
    key = os.readlink("d/count/current")
    (Path("d/count") / key).rename("aside")
    (Path("d/count") / key).symlink_to(precious)
    for name in ("dataset.json", "in_use.json", ".work/digests.json", ".work/dataset.json"):
        Path("d", name).unlink()
        Path("d", name).symlink_to(precious / "file")
    (Path("d") / f".in_use.json.{os.getpid()}").symlink_to(precious / "file")
    assert command("all", capture.root, "--dataset", "d").status == 0
    assert not (Path("d/count") / key).is_symlink() and untouched(precious)


def test_a_manifest_whose_paths_lead_outside_is_no_version(command, capture, precious):
    command("all", capture.root, "--dataset", "d")
    path = Path("d/count/current/manifest.json")
    manifest = json.loads(path.read_text())
    for bad in ("../../../precious/file", str(precious / "file")):
        manifest["outputs"][0] = {"path": bad, "bytes": 4, "digest": "0" * 32}
        path.write_text(json.dumps(manifest))
        assert Dataset(Path("d")).current("count") is None
    assert command("verify", "--dataset", "d", "--repair").status == 0 and untouched(precious)


def test_views_of_a_forged_table_become_no_paths(command, capture, stages, precious):
    command("all", capture.root, "--dataset", "d")
    from pipeline.engine.inputs_check import refuse_unsafe_tables

    version = Dataset(Path("d")).current("count")
    assert version is not None
    for views in ({"../../x": {}}, {"/abs": {}}, {"a\0b": {}}, {"x" * 300: {}}, ["a"], 3):
        (version.folder / "frames.json").write_text(json.dumps({"views": views}))
        with pytest.raises(UserError, match=r"frames\.json.*damaged.*verify"):
            refuse_unsafe_tables(Dataset(Path("d")), [version])


SHAPES = (
    *("", "[]", "3", "null", '"x"', "{", "[" * 100_000, "\x00\xff"),
    '{"schema": 1, "plan": [], "given": 3, "capture": 5}',
    '{"capture": "../capture", "plan": {"count": 4}, "given": {"parameters": [], "environments": {"a": 1}}}',
    '{"stage": "count", "key": 3, "outputs": {"a": 1}, "inputs": []}',
    '{"schema": 2, "files": {"a": 3}, "count": [1]}',
)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["dataset.json", "in_use.json", ".work/digests.json", ".work/verified.json", "manifest"])
@pytest.mark.parametrize("text", SHAPES, ids=range(len(SHAPES)))
def test_small_files_of_another_shape_are_one_line_or_no_matter(command, capture, name, text):
    command("all", capture.root, "--dataset", "d")
    path = Path("d", name) if name != "manifest" else Path("d/count/current/manifest.json")
    path.write_text(text, encoding="latin-1")
    for arguments in (("plan",), ("report",), ("count",), ("all",), ("gc", "--yes"), ("verify",)):
        done = command(*arguments[:1], *((capture.root,) if arguments[0] != "gc" else ()), "--dataset", "d", *arguments[1:])
        assert done.status in (0, 1, 2) and "Traceback" not in done.text and done.err.count("polarfield:") <= 1
    assert Path("d/double/current/double.txt").read_text() == "84"
