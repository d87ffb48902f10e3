"""Hostile captures and datasets, each through the program: nothing executed, nothing outside touched, little memory, one line.

    python tests/hostile/run.py [--every N] [--kinds capture,dataset] [--only WORDS]

Runs are forks of one process that has loaded the exact stages (decode, poses, masks), as the crash points' are. Each must end
with status 0, or with 2 and one line of the program's own, without a traceback, within 2 GiB and half a minute, and leave
everything but the dataset as it was.
"""

from __future__ import annotations

import argparse
import hashlib
import os
import resource
import shutil
import signal
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path

HERE = Path(__file__).parent
os.environ["OPENIMAGEIO_THREADS"] = "1"  # a fork has none of its parent's threads
sys.path[:0] = [str(HERE), str(HERE.parent / "crash"), str(HERE.parents[1])]

MOST_BYTES = 2 << 30
MOST_SECONDS = 30
OURS = ("dataset", "log")  # what the program and its forks may write
ON_CAPTURES = ("plan", "all")
ON_DATASETS = ("plan", "all", "verify --repair", "gc --yes", "report")


class Place:
    """A folder with what must stay as it is (`outside`), a capture, a finished dataset, and the program over them."""

    def __init__(self, base: Path) -> None:
        import OpenImageIO
        import scenes

        OpenImageIO.attribute("exr_threads", -1)  # nor a pool of threads for EXR files
        self.base = base
        self.scene = scenes.SCENES["real"](base / "sound")
        self.whole = base / "whole"
        self.whole.mkdir()
        status, said, _ = self.call("all", self.scene.capture, self.whole)
        assert status == 0, said

    def tried(self, kind: str, damage: Callable[[Path], object]) -> list[str]:
        """What is wrong with what the program does; empty where nothing is."""
        work = self.base / "work"
        if work.exists():
            shutil.rmtree(work)
        (work / "outside" / "0123456789abcdef").mkdir(parents=True)
        for name in ("file", "0123456789abcdef/data"):
            (work / "outside" / name).write_text("keep\n")
        shutil.copytree(self.scene.capture, work / "capture")
        dataset = work / "dataset"
        shutil.copytree(self.whole, dataset, symlinks=True) if kind == "dataset" else dataset.mkdir()
        here = os.getcwd()
        os.chdir(work)
        try:
            damage(dataset if kind == "dataset" else work / "capture")
            before = state(work, OURS)
            faults = []
            for command in ON_DATASETS if kind == "dataset" else ON_CAPTURES:
                status, said, peak = self.call(command, work / "capture", dataset)
                faults += [f"{command}: {fault}" for fault in wrong(status, said, peak)]
            after = state(work, OURS)
        finally:
            os.chdir(here)
        changed = sorted(k for k in {*before, *after} if before.get(k) != after.get(k))
        return faults + [f"changed outside: {', '.join(changed[:3])}"] * bool(changed)

    def call(self, command: str, capture: Path, dataset: Path) -> tuple[int, str, int]:
        """Status, what was said, and peak memory (bytes) of a command in a fork."""
        self.scene.capture, sound = capture, self.scene.capture
        from forks import end_as

        log = self.base / "log"
        log.write_text("")
        pid = os.fork()
        if pid == 0:
            end_as(lambda: self._run(command, capture, dataset), log)
        status, usage = _waited(pid)
        self.scene.capture = sound
        stages = dataset.parent / "log"  # of the stages' own forks
        said = log.read_text(errors="replace") + (stages.read_text(errors="replace") if stages.is_file() else "")
        stages.unlink(missing_ok=True)
        return status, said, usage

    def _run(self, command: str, capture: Path, dataset: Path) -> int:
        from pipeline.engine import cli

        os.setsid()
        resource.setrlimit(resource.RLIMIT_DATA, (2 * MOST_BYTES, 2 * MOST_BYTES))
        name, *more = command.split()
        cli.load_stages = lambda modules: self.scene.stages
        cli.run_stage = self.scene.run_stage
        about = [str(capture)] if name != "gc" else []
        return cli.main(self.scene.program, [name, *about, "--dataset", str(dataset), *more])


def _waited(pid: int) -> tuple[int, int]:
    """A fork's status and peak memory, its children's included; after too long it and all it started are ended."""
    deadline = time.monotonic() + MOST_SECONDS
    while True:
        done, status, usage = os.wait4(pid, os.WNOHANG)
        if done:
            return os.waitstatus_to_exitcode(status), usage.ru_maxrss * 1024
        if time.monotonic() > deadline:
            os.killpg(pid, signal.SIGKILL)
            os.waitpid(pid, 0)
            return 124, 0
        time.sleep(0.005)


def wrong(status: int, said: str, peak: int) -> Iterator[str]:
    """Faults of one call."""
    if "Traceback" in said:
        yield f"a traceback: {said.strip().splitlines()[-1][:200]}"
    lines = [line for line in said.splitlines() if line.startswith("polarfield: ")]
    if status not in (0, 2) and not (status == 1 and "damaged" in said):  # `verify` says with 1 that it found something
        yield f"status {status}: {said.strip()[-200:]!r}"
    if status == 2 and len(lines) != 1:
        yield f"{len(lines)} lines: {said.strip()[-300:]!r}"
    if any(len(line) > 2000 or "\x1b" in line for line in lines):
        yield f"a line of {max(map(len, lines))} characters, or with escapes"
    if peak > MOST_BYTES:
        yield f"{peak >> 20} MB"


def state(work: Path, aside: tuple[str, ...]) -> dict[str, str]:
    """Everything in a folder but one part of it: kinds, sizes, times of writing, contents of small files."""
    out = {}
    for folder, folders, files in os.walk(work):
        if Path(folder) == work:
            folders[:], files = ([n for n in names if n not in aside] for names in (folders, files))
        for name in sorted([*folders, *files]):
            path = Path(folder) / name
            facts = path.lstat()
            told = f"{facts.st_mode:o} {facts.st_size if not path.is_dir() else ''} {facts.st_mtime_ns}"
            plain = path.is_file() and not path.is_symlink() and facts.st_size < 1 << 20
            out[str(path.relative_to(work))] = told + (hashlib.md5(path.read_bytes()).hexdigest() if plain else "")
    return out


def main() -> int:
    """Go through the cases; 1 where one is not held."""
    from captures import capture_cases
    from datasets import dataset_cases

    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--every", type=int, default=1, help="try each n-th case alone")
    parser.add_argument("--kinds", default="capture,dataset", help="what to damage")
    parser.add_argument("--only", default="", help="cases whose name has this")
    options = parser.parse_args()
    memory = "/dev/shm" if os.access("/dev/shm", os.W_OK) else None
    with tempfile.TemporaryDirectory(dir=memory, prefix="hostile-") as folder:
        place = Place(Path(folder))
        kinds = {"capture": capture_cases, "dataset": dataset_cases}
        cases = [(kind, *case) for kind, of in kinds.items() if kind in options.kinds for case in of()]
        tried = bad = 0
        for kind, name, damage in cases[:: options.every]:
            if options.only in name:
                tried += 1
                if faults := place.tried(kind, damage):
                    bad += 1
                    print(f"{kind}: {name!r:.100}: {'; '.join(faults)}", flush=True)
        print(f"{len(cases)} cases, {tried} tried, {bad} not held")
    return int(bad > 0)


if __name__ == "__main__":
    sys.exit(main())
