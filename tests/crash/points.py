"""Stop a small run before each of its changes to the disk in turn, in four ways, and see whether the same command mends it.

    python tests/crash/points.py [--every N] [--ways exit,eio,enospc,power]

Started by itself it compiles `shim.c` and begins anew with it preloaded: every open for writing, write, fsync, rename, link,
unlink, mkdir and truncate below the dataset is counted, of native libraries too. Runs are forks of one process that has
loaded everything.
After each stop: `plan` and `all` must succeed, leave the digests of an undisturbed run, and nothing else.
`power`: what no fsync had made durable is gone, in three ways: contents alone; folders' entries too; entries at random.
"""

from __future__ import annotations

import argparse
import ctypes
import os
import random
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

HERE = Path(__file__).parent
ROOT = HERE.parents[1]
WAYS = {"exit": 1, "eio": 2, "enospc": 3, "power": 1}
LOSSES = ("contents", "entries", "some")
SHIM = "POLARFIELD_CRASH_SHIM"


def compiled(folder: Path) -> Path:
    """The shim, compiled."""
    library = folder / "shim.so"
    compiler = shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")
    if compiler is None:
        sys.exit("crash points: a C compiler is needed (apt-get install gcc)")
    subprocess.run([compiler, "-O1", "-shared", "-fPIC", "-o", library, HERE / "shim.c", "-ldl"], check=True)
    return library


class Shim:
    """The preloaded library of this process."""

    def __init__(self) -> None:
        self.library = ctypes.CDLL(os.environ[SHIM])
        self.library.crash_count.restype = ctypes.c_long
        self.library.crash_arm.argtypes = [ctypes.c_char_p, ctypes.c_long, ctypes.c_int, ctypes.c_char_p]

    def arm(self, folder: Path, number: int, mode: int, store: Path | None = None) -> None:
        """Count changes below `folder` from here on; do what `mode` says at the one of this number."""
        self.library.crash_arm(os.fsencode(folder), number, mode, os.fsencode(store) if store else b"")

    def disarm(self) -> None:
        """Let everything pass."""
        self.library.crash_disarm()

    def count(self) -> int:
        """Changes since `arm`, of forks too."""
        return self.library.crash_count()


def forked(work: Callable[[], int], log: Path) -> int:
    """The exit status of `work` in a fork whose output goes to a file."""
    from forks import end_as

    pid = os.fork()
    if pid == 0:
        end_as(work, log)
    return os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])


def after_power_loss(folder: Path, store: Path, how: str, dice: random.Random) -> None:
    """Make of a dataset what a disk would hold that lost power: `store` has what each fsync made durable."""
    aside = folder.with_name(folder.name + "-lost")

    def durable_file(inode: int, target: Path) -> None:
        kept = store / f"f-{inode}"
        target.write_bytes(kept.read_bytes() if kept.exists() else b"")

    def entries(now: Path | None, inode: int) -> dict[str, tuple[str, int, str]]:
        kept = store / f"d-{inode}"
        lines = kept.read_text().splitlines() if kept.exists() else []
        old = {}
        for line in lines:
            head, _, target = line.partition("\t")
            kind, number, name = head.split(" ", 2)
            old[name] = (kind, int(number), target)
        new = {}
        for path in now.iterdir() if now is not None else ():
            kind = "l" if path.is_symlink() else "d" if path.is_dir() else "f"
            new[path.name] = (kind, path.lstat().st_ino, os.readlink(path) if kind == "l" else "")
        if how == "contents":
            return new
        if how == "entries":
            return old
        names = sorted({*old, *new})
        return {n: e for n in names if (e := (old if dice.random() < 0.5 else new).get(n))}

    def rebuild(now: Path | None, inode: int, target: Path) -> None:
        target.mkdir()
        for name, (kind, number, link) in entries(now, inode).items():
            if kind == "l":
                (target / name).symlink_to(link)
            elif kind == "f":
                durable_file(number, target / name)
            else:
                inner = by_inode.get(number)
                rebuild(inner, number, target / name)

    by_inode = {p.stat().st_ino: p for p in folder.rglob("*") if p.is_dir() and not p.is_symlink()}
    rebuild(folder, folder.stat().st_ino, aside)
    shutil.rmtree(folder)
    aside.rename(folder)


def contents(folder: Path) -> dict[str, str]:
    """Every file of a dataset by its path, those under a stage's key by their bytes; what holds times, by its name alone."""
    import hashlib

    out = {}
    for path in sorted(folder.rglob("*")):
        name = path.relative_to(folder).as_posix()
        if path.is_symlink():
            out[name] = os.readlink(path)
        elif path.is_file():
            told = name.startswith(".work") or path.name in ("manifest.json", "metrics.json", "report.html")
            out[name] = "" if told else hashlib.blake2b(path.read_bytes()).hexdigest()
        elif not any(path.iterdir()) and not name.startswith(".work"):
            out[name] = "an empty folder"
    return {k: v for k, v in out.items() if not k.endswith(".lock")}


def stopped(shim: Shim, scene, way: str, number: int, base: Path) -> str:
    """One stop and its mending; returns what is wrong, or nothing. `scene` has the calls and the digests to come back."""
    dataset, store, log = base / "d", base / "store", base / "log"
    shutil.rmtree(base, ignore_errors=True)
    store.mkdir(parents=True)
    dataset.mkdir()
    shim.arm(dataset, number, WAYS[way], store if way == "power" else None)
    status = forked(lambda: scene.call("all", dataset), log)
    shim.disarm()
    if way == "power":
        how = LOSSES[number % len(LOSSES)]
        after_power_loss(dataset, store, how, random.Random(number))
    said = log.read_text()
    if "Traceback" in said:
        return f"a traceback: {said.splitlines()[-1]}"
    if status not in (0, 2, 137):
        return f"status {status}"
    for command in ("plan", "all"):
        if status := forked(lambda: scene.call(command, dataset), log):  # noqa: B023
            return f"`{command}` afterwards: status {status}, {log.read_text().splitlines()[-1]}"
    found = contents(dataset)
    wrong = sorted({k for k in {*found, *scene.whole} if found.get(k) != scene.whole.get(k)})
    return f"differs: {', '.join(wrong[:4])}" if wrong else ""


def check(shim: Shim, scene, ways: list[str], every: int, base: Path) -> int:
    """All stops of a scene; prints how many, and each that is not mended; returns how many are not."""
    whole = base / "whole" / "d"
    whole.mkdir(parents=True)
    shim.arm(whole, 0, 0)
    if forked(lambda: scene.call("all", whole), base / "log"):
        sys.exit((base / "log").read_text())
    points = shim.count()
    shim.disarm()
    scene.whole = contents(whole)
    bad = tried = 0
    for way in ways:
        started = time.monotonic()
        for number in range(1 + random.Random(way).randrange(every), points + 1, every):
            tried += 1
            if fault := stopped(shim, scene, way, number, base / "one"):
                bad += 1
                print(f"{scene.name}: {way} before change {number}: {fault}", flush=True)
        print(f"{scene.name}: {way}: {time.monotonic() - started:.0f} s", flush=True)
    print(f"{scene.name}: {points} points, {tried} stops tried, {bad} not mended", flush=True)
    return bad


def main() -> int:
    """Parse, preload, go through the scenes; returns 1 where a stop is not mended."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--every", type=int, default=1, help="try each n-th point alone")
    parser.add_argument("--ways", default=",".join(WAYS), help="how to stop")
    parser.add_argument("--scenes", default="stub,real", help="stub: tiny stages; real: decode, poses, masks of 16 px")
    options = parser.parse_args()
    memory = "/dev/shm" if os.access("/dev/shm", os.W_OK) else None
    with tempfile.TemporaryDirectory(dir=memory, prefix="crash-") as folder:
        if SHIM not in os.environ:
            shim = str(compiled(Path(folder)))
            environment = {**os.environ, SHIM: shim, "LD_PRELOAD": shim, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}
            again = [sys.executable, str(HERE / "points.py"), *sys.argv[1:]]
            return subprocess.run(again, env=environment, cwd=ROOT).returncode
        sys.path.insert(0, str(HERE))
        import scenes

        bad = 0
        for name in options.scenes.split(","):
            scene = scenes.SCENES[name](Path(folder) / f"{name}-capture")
            bad += check(Shim(), scene, options.ways.split(","), options.every, Path(folder) / name)
        return int(bad > 0)


if __name__ == "__main__":
    sys.exit(main())
