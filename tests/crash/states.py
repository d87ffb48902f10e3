"""What a folder holds at a moment: kept in memory, put back elsewhere, compared; and what is left of it without power."""

from __future__ import annotations

import hashlib
import os
import random
import re
import shutil
from pathlib import Path

from pipeline.engine.dataset.documents import SEAL, seal_fits

State = dict[str, tuple[str, bytes]]
"""Path below the folder to "d", "l" or "f", and the target or the content; folders come before what they hold."""
LOSSES = ("contents", "entries", "some")
"""What is gone of that which no fsync made durable: contents alone; folders' entries too; entries at random."""
CLOCKED = re.compile(rb'"(started|wall_s|cpu_s|peak_rss_mb|expected_\w+|compile_s|seal)": ?("[^"]*"|[-+.\de]+)')
"""Parts of our small files that differ from run to run."""
TOLD = ("manifest.json", "metrics.json", "report.html")
"""Files that hold times."""
_seen: dict[bytes, bytes] = {}


def state_of(folder: Path) -> State:
    """Everything in a folder; what vanishes meanwhile is left out."""
    out: State = {}
    for where, folders, names in os.walk(folder):
        below = os.path.relpath(where, folder)
        for name in (*folders, *names):
            path = os.path.join(where, name)
            key = name if below == "." else f"{below}/{name}"
            try:
                if os.path.islink(path):
                    out[key] = "l", os.fsencode(os.readlink(path))
                elif os.path.isdir(path):
                    out[key] = "d", b""
                else:
                    with open(path, "rb") as stream:
                        out[key] = "f", _once(stream.read())
            except FileNotFoundError:
                continue
    return out


def _once(content: bytes) -> bytes:
    return _seen.setdefault(content, content)


def put_back(state: State, folder: Path) -> None:
    """Make a folder that holds this and nothing else."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    for name, (kind, content) in state.items():
        path = folder / name
        if kind == "d":
            path.mkdir(parents=True, exist_ok=True)
        elif kind == "l":
            path.symlink_to(os.fsdecode(content))
        else:
            path.write_bytes(content)


def identity(folder: Path) -> str:
    """A digest of what a folder holds but for times and numbers of processes: the program goes on alike from two of one."""
    total = hashlib.blake2b()
    for name, (kind, content) in sorted(state_of(folder).items()):
        if kind == "f" and (SEAL.search(content) or b'"wall_s"' in content):
            content = CLOCKED.sub(rb'"\1"', content) + str(seal_fits(folder / name)).encode()
        plain = re.sub(r"(?<=[.-])\d+(?=$|\.old$)", "N", name)
        total.update(repr((plain, kind, len(content))).encode() + content)
    return total.hexdigest()


def after_power_loss(folder: Path, store: Path, how: str, dice: random.Random) -> State:
    """What a disk would hold of a folder that lost power now: `store` has what each fsync made durable; `how`: of LOSSES."""
    by_inode = {p.stat().st_ino: p for p in folder.rglob("*") if p.is_dir() and not p.is_symlink()}
    out: State = {}

    def durable(inode: int, now: Path | None) -> dict[str, tuple[str, int, str]]:
        kept = store / f"d-{inode}"
        old = {}
        for line in kept.read_text().splitlines() if kept.exists() else []:
            head, _, target = line.partition("\t")
            kind, number, name = head.split(" ", 2)
            old[name] = (kind, int(number), target)
        if how == "entries":
            return old
        new = _entries(now) if now is not None else {}
        if how == "contents":
            return new
        return {n: e for n in sorted({*old, *new}) if (e := (old if dice.random() < 0.5 else new).get(n))}

    def rebuild(inode: int, now: Path | None, below: str) -> None:
        for name, (kind, number, link) in durable(inode, now).items():
            if kind == "d":
                out[below + name] = "d", b""
                rebuild(number, by_inode.get(number), f"{below}{name}/")
            elif kind == "l":
                out[below + name] = "l", link.encode()
            else:
                kept = store / f"f-{number}"
                out[below + name] = "f", _once(kept.read_bytes() if kept.exists() else b"")

    rebuild(folder.stat().st_ino, folder, "")
    return out


def _entries(folder: Path) -> dict[str, tuple[str, int, str]]:
    """Kind, number on the disk and target of everything that lies in a folder."""
    out = {}
    for path in folder.iterdir():
        kind = "l" if path.is_symlink() else "d" if path.is_dir() else "f"
        try:
            out[path.name] = (kind, path.lstat().st_ino, os.readlink(path) if kind == "l" else "")
        except FileNotFoundError:
            continue
    return out


def results(folder: Path) -> dict[str, str]:
    """Every file of a dataset by its path, those under a stage's key by their bytes; what holds times, by its name alone."""
    out = {}
    for path in sorted(folder.rglob("*")):
        name = path.relative_to(folder).as_posix()
        if path.is_symlink():
            out[name] = os.readlink(path)
        elif path.is_file():
            out[name] = "" if name.startswith(".work") or path.name in TOLD else hashlib.blake2b(path.read_bytes()).hexdigest()
        elif not any(path.iterdir()) and not name.startswith(".work"):
            out[name] = "an empty folder"
    return {k: v for k, v in out.items() if not k.endswith(".lock")}
