"""verify finds every damaged byte of what is in use, and repair and a run give the old files back and redo nothing else."""

from __future__ import annotations

import json
import os
import shutil
from pathlib import Path

import pytest

from pipeline.engine.dataset.documents import seal_fits, sealed

STAGES = ("count", "double", "relight", "metrics")


def files(dataset: Path = Path("d")) -> list[Path]:
    found = (p for p in sorted(dataset.rglob("*")) if p.is_file() and not p.is_symlink() and p.suffix != ".lock")
    return [p for p in found if p.stat().st_size]


def digests(dataset: Path = Path("d")) -> dict[str, dict]:
    out = {}
    for stage in STAGES:
        manifest = json.loads((dataset / stage / "current" / "manifest.json").read_text())
        out[stage] = {o["path"]: o["digest"] for o in manifest["outputs"]}
    return out


def flip(path: Path, at: int, bit: int) -> None:
    """One bit, as a disk flips it: size and time stay."""
    stat = path.stat()
    content = bytearray(path.read_bytes())
    content[at % len(content)] ^= 1 << bit
    path.write_bytes(content)
    os.utime(path, ns=(stat.st_atime_ns, stat.st_mtime_ns))


@pytest.mark.slow
def test_a_bit_flipped_in_any_file_is_named_and_repaired_and_no_other_stage_is_made_again(command, capture):
    command("all", capture.root, "--dataset", "d")
    assert command("verify", "--dataset", "d").status == 0
    whole = digests()
    for k, path in enumerate(files()):
        flip(path, 7 * k + 11, k % 8)
        found = command("verify", "--dataset", "d", "--full")
        assert found.status == 1 and f"damaged: {path} " in found.out, path
        assert command("verify", "--dataset", "d", "--repair", "--full").status == 0
        again = command("all", "--dataset", "d")
        assert again.status == 0 and again.ran == ([path.parts[1]] if path.parts[1] in STAGES else []), path
        assert digests() == whole and command("verify", "--dataset", "d", "--full").status == 0, path


@pytest.mark.slow
def test_bits_anywhere_in_the_small_files_count(command, capture):
    command("all", capture.root, "--dataset", "d")
    for path in (Path("d/in_use.json"), Path("d/dataset.json"), Path("d/.work/digests.json")):
        content = path.read_bytes()
        for at in range(0, len(content), max(1, len(content) // 40)):
            path.write_bytes(content)
            flip(path, at, at % 8)
            assert f"damaged: {path} " in command("verify", "--dataset", "d").out, (path, at)
        path.write_bytes(content)


def test_missing_files_and_versions_are_named(command, capture):
    command("all", capture.root, "--dataset", "d")
    Path("d/count/current/count.txt").unlink()
    key = os.readlink("d/double/current")
    shutil.rmtree(f"d/double/{key}")
    found = command("verify", "--dataset", "d")
    assert found.status == 1 and "count.txt is missing" in found.out and f"d/double/{key}/manifest.json is missing" in found.out


def test_what_was_read_once_is_not_read_again_unless_asked(command, capture, monkeypatch):
    command("all", capture.root, "--dataset", "d")
    command("verify", "--dataset", "d")
    read: list[Path] = []
    from pipeline.engine.dataset import damage, digests

    monkeypatch.setattr(damage, "digest_file", lambda path, told=None: read.append(path) or digests.digest_file(path, told))
    assert command("verify", "--dataset", "d").status == 0 and read == []
    os.utime("d/count/current/count.txt")
    assert command("verify", "--dataset", "d").status == 0 and [p.name for p in read] == ["count.txt"]
    assert command("verify", "--dataset", "d", "--full").status == 0 and len(read) == 5


def test_a_damaged_version_upstream_of_what_is_in_use_is_found(command, capture):
    command("all", capture.root, "--dataset", "d")
    used = os.readlink("d/count/current")
    command("count", "--dataset", "d", "--factor", "7")
    flip(Path(f"d/count/{used}/count.txt"), 0, 1)
    assert f"damaged: d/count/{used}/count.txt" in command("verify", "--dataset", "d").out


def test_a_stage_that_meets_a_damaged_input_says_verify(command, capture):
    command("all", capture.root, "--dataset", "d")
    path = Path("d/count/current/count.txt")
    path.write_text("x2")  # the size that it had
    (Path("d/double") / os.readlink("d/double/current")).rename("aside")
    stopped = command("all", "--dataset", "d")
    assert stopped.status == 2 and "count.txt" in stopped.err and "verify" in stopped.err and "source" not in stopped.err
    assert command("verify", "--dataset", "d", "--repair").status == 0
    assert command("all", "--dataset", "d").ran == ["count", "double"]
    assert Path("d/double/current/double.txt").read_text() == "84"


def test_a_stage_that_fails_on_whole_inputs_keeps_its_own_fault(command, capture):
    (capture.root / "number.txt").write_text("no number")
    with pytest.raises(ValueError, match="invalid literal"):
        command("all", capture.root, "--dataset", "d")


def test_a_seal_is_of_every_byte(tmp_path):
    path = tmp_path / "a.json"
    path.write_text(sealed({"a": ["0" * 32, 3], "b": {"seal": "0" * 32}}))
    assert seal_fits(path) is True
    content = path.read_bytes()
    for at in range(len(content)):
        path.write_bytes(content)
        flip(path, at, at % 8)
        fits = seal_fits(path)
        if fits is None:  # no seal to be seen: then it is no JSON either
            with pytest.raises(ValueError):
                json.loads(path.read_bytes())
        else:
            assert fits is False, at
