"""Kill small runs at random moments, and see whether the same commands make of what is left what an undisturbed run makes.

    python tests/crash/kills.py [--kills 1000] [--scenes stub,real,stage,colmap] [--seed 0] [--jobs 2]

Every kill is SIGKILL to all processes of a command, or to one of them, at a moment drawn evenly from the time that the
command takes: `all` of a new dataset or of a half-made one; `gc`, `verify` or `verify --repair` of one with a version to
spare. Runs are forks of one process that has loaded everything. After up to six kills the dataset is brought up to date
and compared file by file.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import random
import shutil
import signal
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

HERE = Path(__file__).parent
AGAIN = 0.75  # chance that what a kill left is killed once more before it is mended
COMMANDS = ("all", "all", "all", "gc", "verify", "repair")
MOST = 6
LONGER = 1.03  # by which a command is taken to last longer, each time that it did not end before its kill
SHARES = {"stub": 0.2, "real": 0.4, "stage": 0.34, "colmap": 0.06}
"""Of the kills, by scene: a run of COLMAP takes seconds."""


def begun(work: Callable[[], int], log: Path) -> int:
    """The process of `work`, the head of a group of its own."""
    from forks import started

    def alone() -> int:
        os.setsid()
        return work()

    return started(alone, log)


def members(group: int) -> list[int]:
    """The processes of a group."""
    found = []
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            try:
                fields = (entry / "stat").read_text().rpartition(")")[2].split()
            except OSError:
                continue
            if int(fields[2]) == group:
                found.append(int(entry.name))
    return found


def wait_for_group(group: int) -> None:
    """Until all its processes have ended: a stage whose parent was killed ends by itself."""
    while True:
        try:
            os.killpg(group, 0)
        except ProcessLookupError:
            return
        time.sleep(0.002)


def killed(work: Callable[[], int], log: Path, after_s: float, dice: random.Random) -> float | None:
    """Start `work` and kill it, or one of its processes alone, after a while; what it took where it had ended by then."""
    group, began, took = begun(work, log), time.monotonic(), None
    while took is None and time.monotonic() - began < after_s:
        time.sleep(0.002)
        took = time.monotonic() - began if os.waitpid(group, os.WNOHANG)[0] else None
    if took is None:
        victims = members(group) if dice.random() < 0.25 else []
        if len(victims) > 1:
            os.kill(dice.choice(victims), signal.SIGKILL)
        else:
            with contextlib.suppress(ProcessLookupError):  # it has not come to be the head of its group yet
                os.killpg(group, signal.SIGKILL)
            os.kill(group, signal.SIGKILL)
        os.waitpid(group, 0)
    wait_for_group(group)
    return took


class Kills:
    """Kills of one scene."""

    def __init__(self, scene, base: Path, seed: int) -> None:
        self.scene, self.base, self.dice = scene, base, random.Random(seed)
        self.log = base / "log"
        self.whole, self.spare = base / "whole" / "d", base / "spare" / "d"
        self.seconds: dict[str, float] = {}
        for dataset in (self.whole, self.spare):
            dataset.mkdir(parents=True)
        self.seconds["all"] = self.timed("all", self.whole)
        self.timed("verify", self.whole)  # as after every mending
        if self.timed("all", self.spare, scene.other) and self.timed("all", self.spare):
            for command in ("verify", "repair", "gc"):
                copy = base / "copy" / "d"
                shutil.rmtree(copy.parent, ignore_errors=True)
                shutil.copytree(self.spare, copy, symlinks=True)
                self.seconds[command] = self.timed(command, copy)

    def work(self, command: str, dataset: Path, parameters: str | None = None) -> Callable[[], int]:
        """A command on a dataset."""
        more = {"all": ("--jobs", "2"), "gc": ("--yes",), "repair": ("--repair",)}.get(command, ())
        verb = "verify" if command == "repair" else command
        return lambda: self.scene.call(verb, dataset, *more, parameters=parameters)

    def timed(self, command: str, dataset: Path, parameters: str | None = None) -> float:
        """Seconds that an undisturbed command takes. Exits where it fails."""
        from forks import status_of

        began = time.monotonic()
        pid = begun(self.work(command, dataset, parameters), self.log)
        if status_of(pid):
            sys.exit(self.log.read_text())
        return time.monotonic() - began

    def one(self) -> tuple[int, str]:
        """A dataset, its kills, its mending: how many kills, and what is wrong, or nothing."""
        from forks import status_of
        from states import results

        command = self.dice.choice(COMMANDS)
        kills, fresh = 0, True
        dataset = self.base / "one" / "d"
        shutil.rmtree(dataset.parent, ignore_errors=True)
        if command == "all":
            dataset.mkdir(parents=True)
        else:
            shutil.copytree(self.spare, dataset, symlinks=True)
        self.log.unlink(missing_ok=True)
        while kills < MOST:
            took = killed(self.work(command, dataset), self.log, self.dice.random() * self.seconds[command], self.dice)
            kills += took is None
            if fresh:  # what is left over of a run takes less; the machine's load changes meanwhile
                self.seconds[command] *= LONGER if took is None else 0.5 * (1 + took / self.seconds[command])
                fresh = False
            if self.dice.random() > AGAIN:
                break
            command = "all"
        for name in ("plan", "all", "gc", "verify"):
            pid = begun(self.work(name, dataset), self.log)
            if status := status_of(pid):
                return kills, f"`{name}` afterwards: status {status}, {self.log.read_text().splitlines()[-1]}"
        if "Traceback" in self.log.read_text():
            return kills, f"a traceback: {self.log.read_text().splitlines()[-1]}"
        found, whole = results(dataset), results(self.whole)
        wrong = sorted({k for k in {*found, *whole} if found.get(k) != whole.get(k)})
        return kills, f"differs: {', '.join(wrong[:4])}" if wrong else ""


def main() -> int:
    """Parse, kill, print how many; returns 1 where something is not mended."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--kills", type=int, default=1000, help="how many in all")
    parser.add_argument("--scenes", default=",".join(SHARES))
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--jobs", type=int, default=1, help="datasets side by side")
    options = parser.parse_args()
    sys.path[:0] = [str(HERE), str(HERE.parents[1])]
    from forks import forked
    from scenes import SCENES

    names = options.scenes.split(",")
    with tempfile.TemporaryDirectory(dir="/dev/shm" if os.access("/dev/shm", os.W_OK) else None, prefix="kills-") as folder:
        os.environ["XDG_CACHE_HOME"] = folder  # what such runs take says nothing of this machine
        bad = []
        for name in names:
            wanted = -(-options.kills * SHARES[name] // sum(SHARES[n] for n in names))
            # a scene puts its own stages in the program's place
            bad.append(forked(lambda: _scene(SCENES[name], Path(folder), int(wanted), options)))  # noqa: B023
    return int(any(bad))


def _scene(kind, folder: Path, wanted: int, options: argparse.Namespace) -> int:
    """The kills of one scene; returns 1 where something is not mended."""
    from forks import side_by_side

    began = time.monotonic()
    scene = kind(folder / f"{kind.name}-capture")
    scene.load(folder)
    share = -(-wanted // options.jobs)
    works = [lambda k=k: _share(scene, folder / f"{kind.name}-{k}", share, options.seed + k) for k in range(options.jobs)]
    found = side_by_side(works)
    kills, bad = sum(f[0] for f in found), sum(f[1] for f in found)
    print(f"{scene.name}: {kills} kills, {bad} not mended ({time.monotonic() - began:.0f} s)", flush=True)
    return int(bad > 0)


def _share(scene, base: Path, wanted: int, seed: int) -> tuple[int, int]:
    """How many kills there were, at least as many as are wanted, and how many datasets were not mended."""
    run, kills, bad = Kills(scene, base, seed), 0, 0
    while kills < wanted:
        more, fault = run.one()
        kills += more
        if fault:
            bad += 1
            print(f"{scene.name}: {fault}", flush=True)
    return kills, bad


if __name__ == "__main__":
    sys.exit(main())
