"""Kill small runs at random moments, and see whether the same commands make of what is left what an undisturbed run makes.

    python tests/crash/kills.py [--kills 1000] [--scenes stub,real,stage] [--seed 0]

Every kill is SIGKILL to all processes of a command, or to one of them, at a moment drawn evenly from the time that the
command takes: `all` of a new dataset or of a half-made one; `gc`, `verify` or `verify --repair` of one with a version to
spare. Runs are forks of one process that has loaded everything. After up to six kills the dataset is brought up to date
and compared file by file.
"""

from __future__ import annotations

import argparse
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


def started(work: Callable[[], int], log: Path) -> int:
    """The process of `work`, the head of a group of its own."""
    from forks import end_as

    pid = os.fork()
    if pid == 0:
        os.setsid()
        end_as(work, log)
    return pid


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


def killed(work: Callable[[], int], log: Path, after_s: float, dice: random.Random) -> bool:
    """Start `work` and kill it, or one of its processes alone, after a while; whether it still ran then."""
    group = started(work, log)
    time.sleep(after_s)
    running = os.waitpid(group, os.WNOHANG)[0] == 0
    if running:
        victims = members(group)
        if dice.random() < 0.25 and len(victims) > 1:
            os.kill(dice.choice(victims), signal.SIGKILL)
        else:
            os.killpg(group, signal.SIGKILL)
        os.waitpid(group, 0)
    while members(group):  # a stage whose parent was killed ends by itself
        time.sleep(0.002)
    return running


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
        began = time.monotonic()
        pid = started(self.work(command, dataset, parameters), self.log)
        if os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]):
            sys.exit(self.log.read_text())
        return time.monotonic() - began

    def one(self) -> tuple[int, str]:
        """A dataset, its kills, its mending: how many kills, and what is wrong, or nothing."""
        from points import contents

        command, kills = self.dice.choice(COMMANDS), 0
        dataset = self.base / "one" / "d"
        shutil.rmtree(dataset.parent, ignore_errors=True)
        if command == "all":
            dataset.mkdir(parents=True)
        else:
            shutil.copytree(self.spare, dataset, symlinks=True)
        self.log.unlink(missing_ok=True)
        while kills < MOST:
            kills += killed(self.work(command, dataset), self.log, self.dice.random() * self.seconds[command], self.dice)
            if self.dice.random() > AGAIN:
                break
            command = "all"
        for name in ("plan", "all", "gc", "verify"):
            pid = started(self.work(name, dataset), self.log)
            if status := os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]):
                return kills, f"`{name}` afterwards: status {status}, {self.log.read_text().splitlines()[-1]}"
        if "Traceback" in self.log.read_text():
            return kills, f"a traceback: {self.log.read_text().splitlines()[-1]}"
        found, whole = contents(dataset), contents(self.whole)
        wrong = sorted({k for k in {*found, *whole} if found.get(k) != whole.get(k)})
        return kills, f"differs: {', '.join(wrong[:4])}" if wrong else ""


def main() -> int:
    """Parse, kill, print how many; returns 1 where something is not mended."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--kills", type=int, default=1000, help="how many in all")
    parser.add_argument("--scenes", default="stub,real,stage")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    sys.path[:0] = [str(HERE), str(HERE.parents[1])]
    import scenes

    names, bad = options.scenes.split(","), 0
    with tempfile.TemporaryDirectory(dir="/dev/shm" if os.access("/dev/shm", os.W_OK) else None, prefix="kills-") as folder:
        for name in names:
            pid = os.fork()  # a scene puts its own stages in the program's place
            if pid:
                bad += os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]) != 0
                continue
            os._exit(_scene(scenes.SCENES[name](Path(folder) / f"{name}-capture"), Path(folder) / name,
                            -(-options.kills // len(names)), options.seed))  # fmt: skip
    return int(bad > 0)


def _scene(scene, base: Path, wanted: int, seed: int) -> int:
    """The kills of one scene; returns 1 where something is not mended."""
    run, kills, bad = Kills(scene, base, seed), 0, 0
    while kills < wanted:
        more, fault = run.one()
        kills += more
        if fault:
            bad += 1
            print(f"{scene.name}: {fault}", flush=True)
    print(f"{scene.name}: {kills} kills, {bad} not mended", flush=True)
    return int(bad > 0)


if __name__ == "__main__":
    sys.exit(main())
