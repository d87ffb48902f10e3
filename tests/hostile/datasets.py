"""Hostile datasets: a finished one whose links, names, locks and small files lead outside, or swallow memory."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

Damage = Callable[[Path], object]
Case = tuple[str, Damage]

OUTSIDE = "../outside"
STAGE = "poses"
FOLDERS = (
    STAGE,
    f"{STAGE}/current",
    f"{STAGE}/KEY",
    f".work/{STAGE}",
    ".work",
    f"{STAGE}/KEY/sparse",
    "masks",
    "decode/KEY/frames",
)
SMALL = (
    "dataset.json",
    "in_use.json",
    ".work/digests.json",
    ".work/verified.json",
    f"{STAGE}/KEY/manifest.json",
    f"{STAGE}/KEY/cameras.json",
)
VERSIONS = (
    "../outside",
    "../../outside",
    "..",
    ".",
    "/",
    "/etc",
    "",
    "a" * 5000,
    "a\nb",
    "0" * 16,
    "$(touch outside/ran)",
    "nul\0l",
    "-rf",
)


def dataset_cases() -> Iterator[Case]:
    """Every damage of a finished dataset by its name."""
    for place in FOLDERS:
        for label, target in {
            "outside": "",
            "the root": "/",
            "itself": "SELF",
            "nothing": "/nowhere",
            "its parent": "..",
        }.items():
            yield f"{place} is a link to {label}", lambda r, p=place, t=target: _linked(r, p, t)
    for place in SMALL:
        yield f"{place} is a link outside", lambda r, p=place: _linked(r, p, "FILE")
        yield f"{place} is a link to zero", lambda r, p=place: _linked(r, p, "/dev/zero")
        yield f"{place} is a hard link outside", lambda r, p=place: _hard(_at(r, p), r)
        yield f"{place} is a pipe", lambda r, p=place: os.mkfifo(_gone(_at(r, p)))
        yield f"{place} is a folder", lambda r, p=place: _gone(_at(r, p)).mkdir()
        yield f"{place} is 3 GB of nothing", lambda r, p=place: _sparse(_gone(_at(r, p)))
        yield f"{place} is deep", lambda r, p=place: _gone(_at(r, p)).write_text("[" * 200_000)
        yield f"{place} is binary", lambda r, p=place: _gone(_at(r, p)).write_bytes(bytes(range(256)) * 40)
    for place in (f".work/{STAGE}/KEY.lock", ".work/in_use.lock", ".work/in_use_file.lock"):
        yield f"{place} is a link outside", lambda r, p=place: _linked(r, p, "FILE")
        yield f"{place} is a link to nothing outside", lambda r, p=place: _linked(r, p, "/outside/new")
        yield f"{place} is a pipe", lambda r, p=place: os.mkfifo(_gone(_at(r, p)))
        yield f"{place} is a folder", lambda r, p=place: _gone(_at(r, p)).mkdir(parents=True)
    yield from _versions()
    yield from _manifests()
    yield "a stray link beside versions", lambda r: (r / STAGE / "0123456789abcdef").symlink_to(_outside(r), True)
    yield "a stray link in .work", lambda r: (r / ".work/decode/0123456789abcdef").symlink_to(_outside(r), True)
    yield "a stage's folder of a strange name", lambda r: (r / "..hidden").symlink_to(_outside(r), True)
    yield "a version of a strange name", lambda r: (r / STAGE / "a\nb").mkdir()
    yield "ten thousand versions", lambda r: [(r / STAGE / f"{k:016x}").mkdir() for k in range(10_000)]
    yield "a socket among outputs", lambda r: os.mkfifo(_at(r, f"{STAGE}/KEY") / "more")
    yield "a link among outputs", lambda r: (_at(r, f"{STAGE}/KEY") / "more").symlink_to(_outside(r), True)
    yield "an output is a link outside", lambda r: _linked(r, f"{STAGE}/KEY/cameras.json", "FILE")
    yield "an output is a hard link outside", lambda r: _hard(_at(r, f"{STAGE}/KEY/cameras.json"), r)


def _key(root: Path, stage: str = STAGE) -> str:
    return os.readlink(root / stage / "current")


def _at(root: Path, place: str) -> Path:
    return root / place.replace("KEY", _key(root, place.removeprefix(".work/").partition("/")[0]) if "KEY" in place else "")


def _outside(root: Path) -> Path:
    return root.parent / "outside"


def _gone(path: Path) -> Path:
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)
    path.parent.mkdir(parents=True, exist_ok=True)
    return path


def _linked(root: Path, place: str, target: str) -> None:
    path, out = _at(root, place), _outside(root)
    to = {"": str(out), "FILE": str(out / "file"), "SELF": path.name, "/outside/new": str(out / "new")}.get(target, target)
    _gone(path).symlink_to(to)


def _hard(path: Path, root: Path) -> None:
    os.link(_outside(root) / "file", _gone(path))


def _sparse(path: Path) -> None:
    path.touch()
    os.truncate(path, 3 << 30)


def _changed(path: Path, change: Callable[[dict[str, Any]], object]) -> None:
    table = json.loads(path.read_text())
    change(table)
    path.write_text(json.dumps(table))


def _versions() -> Iterator[Case]:
    for number, name in enumerate(VERSIONS):
        if name and "\0" not in name and len(name) < 4000:
            yield f"current leads to version {number}", lambda r, n=name: _gone(r / STAGE / "current").symlink_to(n)

        def in_use(root: Path, name: str = name) -> None:
            (root / STAGE / "current").unlink()

            def swap(value: Any) -> Any:
                if isinstance(value, dict):
                    return {k: name if k == STAGE else swap(v) for k, v in value.items()}
                return value

            path = root / "in_use.json"
            path.write_text(json.dumps(swap(json.loads(path.read_text()))))

        yield f"in_use.json names version {number}", in_use


def _manifests() -> Iterator[Case]:
    for number, name in enumerate((*VERSIONS, "../../../outside/file", "sparse/../../../../outside/file")):

        def output(root: Path, name: str = name) -> None:
            entry = {"path": name, "bytes": 5, "digest": "0" * 32}
            _changed(_at(root, f"{STAGE}/KEY/manifest.json"), lambda t: t["outputs"].append(entry))

        yield f"manifest names output {number}", output

        def upstream(root: Path, name: str = name) -> None:
            _changed(
                _at(root, "masks/KEY/manifest.json"), lambda t: t.update(inputs={k: name for k in t.get("inputs") or ["poses"]})
            )

        yield f"manifest names input {number}", upstream

        def capture(root: Path, name: str = name) -> None:
            _changed(root / "dataset.json", lambda t: t.update(capture=name))

        yield f"dataset.json names capture {number}", capture

        def view(root: Path, name: str = name) -> None:
            def rename(table: dict[str, Any]) -> None:
                for frame in table.get("frames", [])[:1]:
                    frame["file_path"] = frame["mask_path"] = frame["view"] = name

            _changed(_at(root, f"{STAGE}/KEY/cameras.json"), rename)

        yield f"cameras.json names view {number}", view
    for size in (2**63, -1, 1e308, "x", None, [[]]):

        def bytes_of(root: Path, size: Any = size) -> None:
            _changed(_at(root, f"{STAGE}/KEY/manifest.json"), lambda t: [o.update(bytes=size) for o in t["outputs"]])

        yield f"manifest says {size} bytes", bytes_of
