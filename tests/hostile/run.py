"""Hostile captures and datasets, each through the program: nothing executed, nothing outside touched, little memory, one line.

    python tests/hostile/run.py [--every N] [--kinds capture,dataset,result,rig] [--only WORDS] [--jobs 2]

Runs are forks of one process that has loaded what they load, as the crash points' are: the exact stages (decode, poses, masks)
for captures and datasets, every stage of a tiny training for results. Each must end with status 0, or with 2 and one line of
the program's own, without a traceback, within 2 GiB and half a minute of the processor, and leave everything but the dataset as
it was.
"""

from __future__ import annotations

import argparse
import copy
import hashlib
import os
import resource
import shutil
import signal
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

HERE = Path(__file__).parent
os.environ["OPENIMAGEIO_THREADS"] = "1"  # a fork has none of its parent's threads
sys.path[:0] = [str(HERE), str(HERE.parent / "crash"), str(HERE.parents[1])]

MOST_BYTES = 2 << 30
MOST_SECONDS = 30  # of the processor; of waiting four times as much
OURS = ("dataset", "log", "exported")  # what the program and its forks may write
ON_CAPTURES = ("plan", "all")
ON_DATASETS = ("plan", "all", "verify --repair", "gc --yes", "report")
TINY = (
    "train.iterations=20 train.max_splats=400 train.hull_resolution=32 relight.cube=16 metrics.mesh_samples=200 "
    "mesh.max_texture=64"
)
ON_RESULTS = {
    "mesh": "mesh --decimate 0.4", "relight": "relight --cube 32", "metrics": "metrics --shown-views 2", "compare": "compare",
    "report": "report", "splat": "export --to splat", "nerfstudio": "export --to nerfstudio", "colmap": "export --to colmap",
    "glb": "export --to glb", "maps": "export --to maps", "verify": "verify",
}  # fmt: skip
READERS = {
    "train/env": "metrics", "train/gbuffer": "mesh relight metrics", "train/test": "metrics compare",
    "decode/frames/": "mesh metrics compare nerfstudio", "relight/": "metrics", "mesh/asset/": "metrics glb splat",
    "masks/0": "mesh relight metrics nerfstudio", "train/gaussians": "splat metrics", "train/splats": "splat metrics",
    "mesh/mesh": "relight metrics", "poses/sparse": "colmap",
    "decode/frames.json": "mesh relight metrics compare nerfstudio", "masks/masks": "mesh relight metrics",
    "poses/cameras": "mesh relight metrics compare nerfstudio colmap", "train/lighting": "mesh relight metrics splat",
    "train/train_log": "metrics", "metrics/metrics": "compare report", "olat/": "relight metrics maps",
    "decode/olat": "relight metrics maps compare", "masks/cam": "relight metrics",
}  # fmt: skip
"""Beginnings of the files that are forged, and the commands that read them; `verify` reads all."""


class Place:
    """A folder with what must stay as it is (`outside`), a capture, a finished dataset, and the program over them."""

    def __init__(self, base: Path) -> None:
        import scenes

        base.mkdir()
        self.base = base
        self.scene = scenes.SCENES["real"](base / "sound")
        self.scene.load(base)
        self.whole = base / "whole"
        self.whole.mkdir()
        status, said, _ = self.call("all", self.scene.capture, self.whole)
        assert status == 0, said

    def apart(self, number: int) -> Place:
        """The same place for work beside that of others."""
        other = copy.copy(self)
        other.base = self.base / f"beside-{number}"
        other.base.mkdir()
        return other

    def commands(self, kind: str, case: str) -> Iterable[str]:
        """What a case is put through."""
        return ON_DATASETS if kind == "dataset" else ON_CAPTURES

    def tried(self, kind: str, case: str, damage: Callable[[Path], object]) -> list[str]:
        """What is wrong with what the program does; empty where nothing is."""
        work = self.base / "work"
        if work.exists():
            shutil.rmtree(work)
        (work / "outside" / "0123456789abcdef").mkdir(parents=True)
        for name in ("file", "0123456789abcdef/data"):
            (work / "outside" / name).write_text("keep\n")
        shutil.copytree(self.scene.capture, work / "capture")
        dataset = work / "dataset"
        shutil.copytree(self.whole, dataset, symlinks=True) if kind != "capture" else dataset.mkdir()
        here = os.getcwd()
        os.chdir(work)
        try:
            damage(work / "capture" if kind == "capture" else dataset)
            before = state(work, OURS)
            faults = []
            for command in self.commands(kind, case):
                status, said, peak = self.call(command, work / "capture", dataset)
                faults += [f"{command}: {fault}" for fault in wrong(status, said, peak)]
                self.undo(work, damage)
            after = state(work, OURS)
        finally:
            os.chdir(here)
        changed = sorted(k for k in {*before, *after} if before.get(k) != after.get(k))
        return faults + [f"changed outside: {', '.join(changed[:3])}"] * bool(changed)

    def undo(self, work: Path, damage: Callable[[Path], object]) -> None:
        """Between two commands: nothing, the second finds what the first left."""

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


class Trained(Place):
    """The same with a dataset of every stage, whose results are read by commands that make others of them."""

    scene_name = "trained"
    left_out = ("maps",)

    def __init__(self, base: Path) -> None:
        from forks import load_what_it_loads
        from scenes import SCENES

        base.mkdir()
        self.base, self.whole = base, base / "whole"
        self.scene = SCENES[self.scene_name](base / "sound")
        capture = self.scene.capture
        log = base / "made"
        load_what_it_loads(lambda: self._run(f"all --params={TINY}", capture, self.whole), log)
        spare = base / "spare"
        for command in (line for name, line in ON_RESULTS.items() if name not in self.left_out):
            shutil.copytree(self.whole, spare / "dataset", symlinks=True)
            load_what_it_loads(lambda: self._run(command, capture, spare / "dataset"), log)  # noqa: B023
            shutil.rmtree(spare)

    def commands(self, kind: str, case: str) -> Iterable[str]:
        """Those that read the file, and `verify`."""
        names = next(names for start, names in READERS.items() if case.startswith(start))
        return [ON_RESULTS[name] for name in (*names.split(), "verify") if name not in self.left_out]

    def undo(self, work: Path, damage: Callable[[Path], object]) -> None:
        """Each command finds the forged dataset, none what the one before has made."""
        for name in ("dataset", "exported"):
            shutil.rmtree(work / name, ignore_errors=True)
        shutil.copytree(self.whole, work / "dataset", symlinks=True)
        damage(work / "dataset")

    def _run(self, command: str, capture: Path, dataset: Path) -> int:
        from pipeline.engine import cli
        from stages.__main__ import PROGRAM

        os.setsid()
        resource.setrlimit(resource.RLIMIT_DATA, (3 * MOST_BYTES, 3 * MOST_BYTES))
        cli.run_stage = self.scene.run_stage
        name, *more = command.split(" ", 1) if "params" in command else command.split()
        out = str(dataset.parent / "exported")
        about = {"compare": [str(dataset), str(dataset), "--out", out], "export": ["--dataset", str(dataset), "--out", out]}
        usual = [str(capture), "--dataset", str(dataset)]
        return cli.main(PROGRAM, [name, *about.get(name, usual), *more])


class Fitted(Trained):
    """The same with a light stage's."""

    scene_name = "fitted"
    left_out = ("mesh", "splat", "nerfstudio", "colmap", "glb")


def _waited(pid: int) -> tuple[int, int]:
    """A fork's status and peak memory, its children's included; after too long it and all it started are ended."""
    deadline = time.monotonic() + 4 * MOST_SECONDS
    while True:
        done, status, usage = os.wait4(pid, os.WNOHANG)
        if done:
            late = usage.ru_utime + usage.ru_stime > MOST_SECONDS
            return 124 if late else os.waitstatus_to_exitcode(status), usage.ru_maxrss * 1024
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
    from forks import forked
    from results import result_cases, rig_cases

    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--every", type=int, default=1, help="try each n-th case alone")
    parser.add_argument("--kinds", default="capture,dataset,result,rig", help="what to damage")
    parser.add_argument("--only", default="", help="cases whose name has this")
    parser.add_argument("--jobs", type=int, default=1, help="cases side by side")
    options = parser.parse_args()
    memory = "/dev/shm" if os.access("/dev/shm", os.W_OK) else None
    bad = 0
    with tempfile.TemporaryDirectory(dir=memory, prefix="hostile-") as folder:
        os.environ["XDG_CACHE_HOME"] = folder  # what such runs take says nothing of this machine
        places: list[tuple[str, type[Place], dict[str, Callable]]] = [
            ("exact", Place, {"capture": capture_cases, "dataset": dataset_cases}),
            ("trained", Trained, {"result": result_cases}),
            ("fitted", Fitted, {"rig": rig_cases}),
        ]  # fmt: skip
        for name, place, kinds in places:
            kinds = {kind: of for kind, of in kinds.items() if kind in options.kinds.split(",")}
            cases = [(kind, *case) for kind, of in kinds.items() for case in of()]
            if cases:
                bad += forked(lambda: _tried(place, Path(folder) / name, cases, options))  # noqa: B023
    return int(bad > 0)


def _tried(kind: type[Place], base: Path, cases: list, options: argparse.Namespace) -> int:
    """The cases of one place; 1 where one is not held."""
    import OpenImageIO
    from forks import side_by_side

    OpenImageIO.attribute("exr_threads", -1)  # nor a pool of threads for EXR files
    chosen = [case for case in cases[:: options.every] if options.only in case[1]]
    place = kind(base)

    def part(number: int) -> int:
        mine = place.apart(number)
        bad = 0
        for sort, name, damage in chosen[number :: options.jobs]:
            if faults := mine.tried(sort, name, damage):
                bad += 1
                print(f"{sort}: {name!r:.100}: {'; '.join(faults)}", flush=True)
        return bad

    bad = sum(side_by_side([lambda k=k: part(k) for k in range(options.jobs)]))
    print(f"{len(cases)} cases, {len(chosen)} tried, {bad} not held", flush=True)
    return int(bad > 0)


if __name__ == "__main__":
    sys.exit(main())
