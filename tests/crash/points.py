"""Stop a small run before each of its changes to the disk in turn, in five ways, and see whether the same command mends it.

    python tests/crash/points.py [--scenes stub,real,stage] [--ways exit,eio,enospc,kill,power] [--every N] [--jobs 2]

Started by itself it compiles `shim.c` and begins anew with it preloaded: every open for writing, write, fsync, rename, link,
unlink, mkdir and truncate below the dataset is counted, of native libraries too. Runs are forks of one process that has
loaded everything.

exit, eio, enospc: the process that is about to change something ends, or is told EIO or (from then on) ENOSPC.
kill, power: one run halts before every change, and what the disk holds then is kept: of `kill` as it is (all processes end at
once), of `power` without what no fsync had made durable, in three ways (`states.LOSSES`).
After each: `plan` and `all` must succeed, leave the digests of an undisturbed run, and nothing else. Of stops that leave the
same on the disk, one is mended.
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
from dataclasses import dataclass, field
from pathlib import Path

HERE = Path(__file__).parent
ROOT = HERE.parents[1]
RUNNING = {"exit": 1, "eio": 2, "enospc": 3}
WATCHED = ("kill", "power")
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

    def arm(self, folder: Path, number: int = 0, mode: int = 0, store: Path | None = None) -> None:
        """Count changes below `folder` from here on; do what `mode` says at the one of this number."""
        self.library.crash_arm(os.fsencode(folder), number, mode, os.fsencode(store) if store else b"")

    def watch(self, asked: int, granted: int) -> None:
        """Have every change ask first, through pipes."""
        self.library.crash_watch(asked, granted)

    def disarm(self) -> None:
        """Let everything pass."""
        self.library.crash_disarm()

    def apart(self) -> None:
        """Count apart from the process that this one is a fork of."""
        self.library.crash_apart()

    def count(self) -> int:
        """Changes since `arm`, of forks too."""
        return self.library.crash_count()


@dataclass(frozen=True)
class Stop:
    """One stop: how, before which change; `left`: what it leaves on the disk (None: a run that stops there leaves it)."""

    way: str
    number: int
    left: dict[str, tuple[str, bytes]] | None = None


@dataclass
class Tally:
    """What came of stops: how many there were, how many left what no other had, and how many were not mended."""

    tried: int = 0
    mended: int = 0
    bad: int = 0
    seconds: float = 0.0
    seen: set[str] = field(default_factory=set)


def watched(shim: Shim, scene, ways: list[str], base: Path) -> list[Stop]:
    """A run that halts before every change; what each would have left, had all its processes ended or the power gone."""
    from forks import started, status_of
    from states import LOSSES, after_power_loss, state_of

    dataset, store = base / "d", base / "store"
    for folder in (dataset, store):
        folder.mkdir(parents=True)
    (asks, asked), (granted, grants) = os.pipe(), os.pipe()
    shim.arm(dataset, store=store)
    shim.watch(asked, granted)
    pid = started(lambda: scene.call("all", dataset), base / "log")
    os.close(asked)
    stops: list[Stop] = []
    number = 0
    while os.read(asks, 1):
        number += 1
        if "kill" in ways:
            stops.append(Stop("kill", number, state_of(dataset)))
        for how in LOSSES if "power" in ways else ():
            stops.append(Stop(f"power ({how})", number, after_power_loss(dataset, store, how, random.Random(number))))
        os.write(grants, b"\0")
    shim.disarm()
    for handle in (asks, granted, grants):
        os.close(handle)
    if status_of(pid):
        sys.exit((base / "log").read_text())
    return stops


def tried(shim: Shim, scene, stop: Stop, base: Path, tally: Tally) -> str:
    """One stop and its mending; returns what is wrong, or nothing. `scene` has the calls and the digests to come back."""
    from forks import forked
    from states import identity, put_back, results

    dataset, log = base / "d", base / "log"
    log.unlink(missing_ok=True)
    if stop.left is not None:
        put_back(stop.left, dataset)
    else:
        put_back({}, dataset)
        shim.arm(dataset, stop.number, RUNNING[stop.way])
        status = forked(lambda: scene.call("all", dataset), log)
        shim.disarm()
        said = log.read_text()
        if "Traceback" in said:
            return f"a traceback: {said.splitlines()[-1]}"
        if status not in (0, 2, 137):
            return f"status {status}"
    found = identity(dataset)
    if found in tally.seen:
        return ""
    tally.seen.add(found)
    tally.mended += 1
    for command in ("plan", "all"):
        if status := forked(lambda: scene.call(command, dataset), log):  # noqa: B023
            return f"`{command}` afterwards: status {status}, {log.read_text().splitlines()[-1]}"
    have = results(dataset)
    wrong = sorted({k for k in {*have, *scene.whole} if have.get(k) != scene.whole.get(k)})
    return f"differs: {', '.join(wrong[:4])}" if wrong else ""


def worked_off(shim: Shim, scene, stops: list[Stop], base: Path) -> Tally:
    """Every one of these stops; each that is not mended is printed."""
    shim.apart()
    tally = Tally()
    began = time.monotonic()
    for stop in stops:
        tally.tried += 1
        if fault := tried(shim, scene, stop, base, tally):
            tally.bad += 1
            print(f"{scene.name}: {stop.way} before change {stop.number}: {fault}", flush=True)
    tally.seconds = time.monotonic() - began
    return tally


def check(shim: Shim, scene, options: argparse.Namespace, base: Path) -> int:
    """All stops of a scene; prints how many, and each that is not mended; returns how many are not."""
    from forks import forked, side_by_side
    from states import results

    whole, ways = base / "whole" / "d", options.ways.split(",")
    whole.mkdir(parents=True)
    shim.arm(whole)
    if forked(lambda: scene.call("all", whole), base / "log"):
        sys.exit((base / "log").read_text())
    points = shim.count()
    shim.disarm()
    scene.whole = results(whole)
    stops = watched(shim, scene, ways, base / "watched") if {*ways} & {*WATCHED} else []
    print(f"{scene.name}: {points} points; {len(stops)} states of the disk at the changes of a watched run", flush=True)
    stops += [Stop(way, number) for way in ways if way in RUNNING for number in range(1, points + 1)]
    stops = stops[random.Random(points).randrange(options.every) :: options.every]
    share = -(-len(stops) // options.jobs)
    parts = [stops[k : k + share] for k in range(0, len(stops), share)]
    tallies = side_by_side([lambda p=p, k=k: worked_off(shim, scene, p, base / f"{k}") for k, p in enumerate(parts)])
    total, mended, bad = (sum(getattr(t, name) for t in tallies) for name in ("tried", "mended", "bad"))
    print(f"{scene.name}: {points} points, {total} stops tried, {bad} not mended "
          f"({mended} left what no other had; {sum(t.seconds for t in tallies):.0f} s)", flush=True)  # fmt: skip
    return bad


def main() -> int:
    """Parse, preload, go through the scenes; returns 1 where a stop is not mended."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--every", type=int, default=1, help="try each n-th stop alone")
    parser.add_argument("--ways", default=",".join([*RUNNING, *WATCHED]), help="how to stop")
    parser.add_argument("--scenes", default="stub,real,stage", help="stub: tiny stages; real: decode, poses, masks of 16 px; "
                        "stage: with the fit of a light stage's cameras")  # fmt: skip
    parser.add_argument("--jobs", type=int, default=1, help="stops side by side")
    options = parser.parse_args()
    memory = "/dev/shm" if os.access("/dev/shm", os.W_OK) else None
    with tempfile.TemporaryDirectory(dir=memory, prefix="crash-") as folder:
        if SHIM not in os.environ:
            shim = str(compiled(Path(folder)))
            environment = {**os.environ, SHIM: shim, "LD_PRELOAD": shim, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}
            again = [sys.executable, str(HERE / "points.py"), *sys.argv[1:]]
            return subprocess.run(again, env=environment, cwd=ROOT).returncode
        sys.path.insert(0, str(HERE))
        os.environ["XDG_CACHE_HOME"] = folder  # what such runs take says nothing of this machine
        from forks import forked
        from scenes import SCENES

        # a scene puts its own stages in the program's place
        bad = [forked(lambda: _scene(SCENES[name], Path(folder), options)) for name in options.scenes.split(",")]  # noqa: B023
        return int(any(bad))


def _scene(kind, folder: Path, options: argparse.Namespace) -> int:
    scene = kind(folder / f"{kind.name}-capture")
    scene.load(folder)
    return int(check(Shim(), scene, options, folder / kind.name) > 0)


if __name__ == "__main__":
    sys.exit(main())
