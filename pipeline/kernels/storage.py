"""The folder that holds compiled code, and what is deleted from it. Does not load numba."""

from __future__ import annotations

import contextlib
import functools
import os
import re
import shutil
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
"""Where the project's packages lie: a checkout, or site-packages."""
CHECKOUT = (ROOT / "pyproject.toml").is_file()
OWN = Path(__file__).parent / "__pycache__" / "machine_code"
"""The folder of this checkout."""

OWN_DAYS, SHARED_DAYS = 1, 14
"""Unused code is deleted after so many days: processes that began before an edit may still be at work in this checkout, and
other checkouts in a folder that they share."""
_RENEW = 3600.0  # seconds after which a use is noted again
_NAME = re.compile(r"-(?P<file>[\w.]+)-(?P<digest>[0-9a-f]{16})\.")


def place() -> Path | None:
    """The folder for compiled code, made if need be; None where none can be written."""
    return _place(os.environ.get("NUMBA_CACHE_DIR"), os.environ.get("XDG_CACHE_HOME"))


@functools.cache
def _place(numba_cache: str | None, xdg_cache: str | None) -> Path | None:
    places = [Path(numba_cache) / "polarfield"] if numba_cache else []
    places.append(OWN)
    with contextlib.suppress(RuntimeError):  # a user without a home
        places.append(Path(xdg_cache or Path.home() / ".cache") / "polarfield" / "machine_code")
    for folder in places:
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError:
            continue
        if os.access(folder, os.W_OK):
            return folder
    return None


def label(name: str, digest: str) -> str:
    """The part of a file's name that says which source file (dotted) and which digest it was compiled from."""
    return f"{name}-{digest}"


@functools.cache
def claim(folder: Path, name: str, digest: str) -> None:
    """Note that code of file `name` in state `digest` is in use, and delete what is in use no more."""
    mark = folder / f"used-{label(name, digest)}.mark"
    with contextlib.suppress(OSError):  # another process's turn, or no room left: neither stops a run
        try:
            age = time.time() - mark.stat().st_mtime
        except FileNotFoundError:
            age = float("inf")
        if age > _RENEW:
            mark.touch()
        if age == float("inf"):
            _borrow(folder, label(name, digest))
        if age > OWN_DAYS * 86400.0:
            clear(folder, name, digest)


def clear(folder: Path, name: str, digest: str) -> None:
    """Delete from `folder` code that this checkout cannot use and nobody used of late.

    That is: code of file `name` in another state than `digest`, and of files that this checkout has not.
    """
    own = folder == OWN
    oldest = time.time() - 86400.0 * (OWN_DAYS if own else SHARED_DAYS)
    if own:
        _clear_numbas_own()
    files = list(folder.iterdir())
    parsed = {file: match for file in files if (match := _NAME.search(file.name))}
    used = {match.group(): file.stat().st_mtime for file, match in parsed.items() if file.suffix == ".mark"}
    for file, match in parsed.items():
        foreign = match["digest"] != digest if match["file"] == name else not _exists(match["file"])
        if foreign and used.get(match.group(), 0.0) < oldest and file.stat().st_mtime < oldest:
            file.unlink(missing_ok=True)


def _borrow(folder: Path, tag: str) -> None:
    """Copy what whoever installed the package compiled, where its user cannot write beside it (data before the index)."""
    if folder == OWN or os.access(OWN, os.W_OK) or not OWN.is_dir():
        return
    for file in sorted(OWN.glob(f"*-{tag}.*")):
        target = folder / file.name
        if not target.exists() and file.suffix != ".mark":
            aside = target.with_name(f"{target.name}.{os.getpid()}")
            shutil.copyfile(file, aside)
            os.replace(aside, target)


def _exists(name: str) -> bool:
    return ROOT.joinpath(*name.split(".")).with_suffix(".py").is_file()


@functools.cache
def _clear_numbas_own() -> None:
    """Delete code that earlier versions kept beside the sources, by rules that let it go stale."""
    for package in ROOT.glob("*/__init__.py") if CHECKOUT else ():
        for cache in package.parent.rglob("__pycache__"):
            for file in (*cache.glob("*.nbi"), *cache.glob("*.nbc"), *cache.glob("kernels-*/**/*.*")):
                file.unlink(missing_ok=True)
