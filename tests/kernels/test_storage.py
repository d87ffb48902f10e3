"""Where compiled code is kept, and what is deleted from there."""

from __future__ import annotations

import os
import time
from pathlib import Path

import pytest

from pipeline.kernels import freshness, kept, storage

NAME, NOW, OLD = "pipeline.kernels.numerics", "a" * 16, "b" * 16
DAY = 86400.0


@pytest.fixture(autouse=True)
def forgotten():
    """Each test finds the folders anew."""
    yield
    storage.claim.cache_clear()
    storage._clear_numbas_own.cache_clear()
    storage._place.cache_clear()


def _kept(folder: Path, name: str, digest: str, days: float, used: float | None = None) -> list[Path]:
    """An index, its data and an object file, written some days ago; and the mark of their last use."""
    tag = storage.label(name, digest)
    files = [folder / f"numerics.f-{tag}.{end}" for end in ("py311.nbi", "py311.1.nbc", "0123.o")]
    marks = [folder / f"used-{tag}.mark"] if used is not None else []
    for file in (*files, *marks):
        file.write_bytes(b"code")
        when = time.time() - DAY * (days if file not in marks else used or 0.0)
        os.utime(file, (when, when))
    return files + marks


def _there(files: list[Path]) -> set[bool]:
    return {file.exists() for file in files}


@pytest.mark.parametrize(
    ("own", "days", "kept"), [(True, 0.5, True), (True, 1.5, False), (False, 10, True), (False, 15, False)]
)
def test_code_of_other_sources_goes_when_nobody_used_it_for_long(tmp_path, monkeypatch, own, days, kept) -> None:
    if own:
        monkeypatch.setattr(storage, "OWN", tmp_path)
    superseded = _kept(tmp_path, NAME, OLD, days=40, used=days)
    unmarked = _kept(tmp_path, NAME, "c" * 16, days=days)
    gone_file = _kept(tmp_path, "pipeline.no_longer_there", OLD, days=40, used=days)
    others = _kept(tmp_path, "pipeline.optics.fresnel", OLD, days=40, used=40)  # decided when that file's kernels are used
    current = _kept(tmp_path, NAME, NOW, days=40)
    storage.claim(tmp_path, NAME, NOW)
    assert _there(superseded) == _there(unmarked) == _there(gone_file) == {kept}
    assert _there(others) == _there(current) == {True}
    assert (tmp_path / f"used-{storage.label(NAME, NOW)}.mark").exists()


def test_a_use_is_noted_again(tmp_path) -> None:
    mark = _kept(tmp_path, NAME, NOW, days=3, used=3)[-1]
    storage.claim(tmp_path, NAME, NOW)
    assert time.time() - mark.stat().st_mtime < 60


def test_numbas_old_files_beside_the_sources_go(checkout) -> None:
    old = checkout.root / "stages/mesh/__pycache__"
    kept_by_numba = checkout.root / "pipeline/lights/__pycache__/kernels-0123456789ab/fit.o"
    numbas = [old / f"kernels.integrate-10.py311.{end}" for end in ("nbi", "1.nbc")]
    for file in (*numbas, old / "x.pyc", kept_by_numba):
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_bytes(b"")
    checkout.run("from pipeline.kernels import storage; storage.claim(storage.place(), 'pipeline.kernels.numerics', 'a' * 16)")
    assert [file.name for file in old.iterdir()] == ["x.pyc"]
    assert not kept_by_numba.exists()


def test_numba_cache_dir_is_heeded(tmp_path, monkeypatch) -> None:
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "mine"))
    assert storage.place() == tmp_path / "mine/polarfield"


def test_an_installation_that_cannot_be_written_uses_the_users_folder(tmp_path, monkeypatch) -> None:
    (tmp_path / "file").write_text("")
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setattr(storage, "OWN", tmp_path / "file" / "machine_code")
    assert storage.place() == tmp_path / "cache/polarfield/machine_code"
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    assert storage.place() is None


def test_code_that_the_installer_compiled_is_borrowed(tmp_path, monkeypatch) -> None:
    installed, mine = tmp_path / "installed", tmp_path / "mine"
    installed.mkdir()
    mine.mkdir()
    monkeypatch.setattr(storage, "OWN", installed)
    monkeypatch.setattr(os, "access", lambda path, mode: Path(path) != installed)
    for digest in (NOW, OLD):
        _kept(installed, NAME, digest, days=40, used=40)
    storage.claim(mine, NAME, NOW)
    assert sorted(file.suffix for file in mine.iterdir()) == [".mark", ".nbc", ".nbi", ".o"]


def test_kernels_of_a_file_that_was_only_loaded_have_yet_to_be_compiled(tmp_path, monkeypatch) -> None:
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    storage._place.cache_clear()
    folder, file = storage.place(), "pipeline/kernels/numerics.py"
    assert folder is not None
    digest = freshness.digest(storage.ROOT / file)
    storage.claim(folder, NAME, digest)
    assert list(folder.glob("*.mark")) and not kept.is_kept.__wrapped__(file)
    _kept(folder, NAME, digest, days=0)
    assert kept.is_kept.__wrapped__(file)
