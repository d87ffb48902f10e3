"""Captures gone wrong at random, through every reader: a sound result, a warning, or one line that names the file.

`POLARFIELD_FUZZ=100000 pytest tests/capture/test_fuzz.py` tries that many; a failure prints its number, which
`POLARFIELD_FUZZ_SEED=NUMBER` alone repeats.
"""

from __future__ import annotations

import contextlib
import json
import os
import random
import shutil
import signal
import tempfile
import warnings
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st

from pipeline.capture import open_capture
from pipeline.capture.naming.safe_names import refuse_unsafe_names
from pipeline.engine.progress import Progress
from pipeline.engine.stage import StageRun
from pipeline.errors import UserError
from pipeline.formats.images import read_exr, write_exr, write_png
from stages.calib.decode.stage import STAGE as DECODE
from stages.calib.poses.stage import STAGE as POSES
from tests.capture import conftest
from tests.capture.conftest import Scene, frame
from tests.capture.mutations import MUTATIONS

TRIES = int(os.environ.get("POLARFIELD_FUZZ", "2000"))
ONLY = os.environ.get("POLARFIELD_FUZZ_SEED")
LONGEST_S = 10
CAMERA_FILE = """#focal length
260 260
#principal point
16 12
#resolution
32 24
#distortion coeffs
0 0 0 0
#camera transformation matrix 1
MATRIX :
1 0 0 0
0 1 0 0
0 0 1 80
0 0 0 1
"""


def photographs(root: Path, scene: Scene) -> None:
    for name in scene.names:
        write_png(root / "images" / f"{name}.png", scene.stokes[name][:, :, 0])


def mosaic(root: Path, scene: Scene) -> None:
    frames = []
    for name in scene.names:
        image = np.zeros((24, 32), np.float32)
        for k, angle in enumerate((90, 45, 135, 0)):
            image[k // 2 :: 2, k % 2 :: 2] = scene.intensity(name, angle)[k // 2 :: 2, k % 2 :: 2, 1]
        write_png(root / "images" / f"{name}.png", image)
        frames.append(frame(scene.cameras[name], f"images/{name}.png"))
    (root / "transforms.json").write_text(json.dumps({"frames": frames}))


def light_stage(root: Path, scene: Scene) -> None:
    rng = np.random.default_rng(3)
    lights = rng.normal(size=(5, 3))
    rows = [",".join(f"{x:.4f}" for x in 100 * v / np.linalg.norm(v)) for v in lights]
    for k in range(len(rows)):
        for kind, level in (("cross", 0.3), ("parallel", 0.5)):
            image = level + 0.1 * rng.random((24, 32)).astype(np.float32)
            write_exr(root / "cam00" / kind / f"{k:06d}.exr", {c: image for c in "RGB"}, half=True)
    write_png(root / "cam00" / "mask.png", np.full((24, 32), 255, np.uint8))
    (root / "lights.csv").write_text("index,x,y,z\n" + "".join(f"{k},{row}\n" for k, row in enumerate(rows)))
    (root / "cameras").mkdir()
    (root / "cameras" / "camera00.txt").write_text(CAMERA_FILE)


WRITERS = {
    **{name: getattr(conftest, name) for name in ("phygap_mitsuba", "stokes_transforms", "polarisers_transforms", "pandora")},
    **{name: getattr(conftest, name) for name in ("smvp3d", "rmvp3d", "angle_stack", "two_camera")},
    **{"photographs": photographs, "mosaic": mosaic, "light_stage": light_stage},
}


@pytest.fixture(scope="module")
def sound(tmp_path_factory) -> Iterator[dict[str, Path]]:
    """One sound capture of every layout."""
    scene = conftest.scene.__wrapped__() if hasattr(conftest.scene, "__wrapped__") else None
    if scene is None:
        pytest.skip("the scene is no plain function")
    out = {}
    for name, write in WRITERS.items():
        out[name] = tmp_path_factory.mktemp("sound") / name
        out[name].mkdir()
        write(out[name], scene)
    yield out


@contextlib.contextmanager
def time_limit() -> Iterator[None]:
    """Raise TimeoutError after LONGEST_S of work, or six times as long of waiting: other programs may hold the cores."""

    def late(number: int, stack: object) -> None:
        raise TimeoutError(f"longer than {LONGEST_S} s")

    clocks = ((signal.SIGPROF, signal.ITIMER_PROF, LONGEST_S), (signal.SIGALRM, signal.ITIMER_REAL, 6 * LONGEST_S))
    before = [signal.signal(number, late) for number, _, _ in clocks]
    for _, clock, seconds in clocks:
        signal.setitimer(clock, seconds)
    try:
        yield
    finally:
        for (number, clock, _), handler in zip(clocks, before):
            signal.setitimer(clock, 0)
            signal.signal(number, handler)


def through_the_readers(root: Path, work: Path) -> str:
    """What comes of a capture up to its cameras: "sound", or the line that refuses it. Anything else raises."""
    try:
        capture = open_capture(root)
        refuse_unsafe_names(capture)
        folders: dict[str, Path] = {}
        for stage in (DECODE, POSES):
            if stage is POSES and not (stage.needed(capture, stage.parameters()).run and capture.cameras):
                break
            output, scratch = work / stage.name, work / f"{stage.name}-scratch"
            output.mkdir()
            scratch.mkdir()
            run = StageRun(capture, stage.parameters(), dict(folders), output, scratch, progress=Progress(quiet=True))
            stage.run(run)
            assert all(isinstance(w, str) and "\n" not in w for w in (*run.warnings, *capture.warnings))
            json.dumps(run.facts, allow_nan=False)
            folders[stage.name] = output
    except UserError as error:
        return str(error)
    for path in sorted(work.rglob("*.exr")):
        assert all(np.isfinite(channel).all() for channel in read_exr(path).values()), path
    for path in sorted(work.rglob("*.json")):
        json.dumps(json.loads(path.read_text()), allow_nan=False)
    return "sound"


def names_its_file(line: str, root: Path) -> bool:
    named = str(root) in line or "capture.toml" in line or line.startswith("/etc/hostname: ")  # which a table names one by one
    return "\n" not in line and len(line) < 3000 and named


def attempt(seed: int, sound: dict[str, Path]) -> None:
    """Spoil a capture as the number says, and hold what comes of it against the rules."""
    rng = random.Random(seed)
    layout = rng.choice(sorted(sound))
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder) / "place"
        root, outside, work = place / "capture", place / "outside", place / "work" / "dataset"
        shutil.copytree(sound[layout], root)
        outside.mkdir()
        work.mkdir(parents=True)
        for mutate in rng.choices(MUTATIONS, k=rng.choice((1, 1, 1, 2, 3))):
            with contextlib.suppress(Exception):  # what an earlier one spoiled can be spoiled no more
                mutate(root, rng)
        before = listing(root)
        with time_limit(), warnings.catch_warnings():
            warnings.simplefilter("ignore")  # numpy's own, of numbers that no camera gives
            line = through_the_readers(root, work)
        assert line == "sound" or names_its_file(line, root), line
        assert listing(root) == before and list(outside.iterdir()) == [], "wrote outside of the dataset"
        assert sorted(p.name for p in place.iterdir()) == ["capture", "outside", "work"]
        assert [p.name for p in (place / "work").iterdir()] == ["dataset"]


def listing(root: Path) -> list[tuple[str, int, int]]:
    return sorted((str(p), p.lstat().st_size, p.lstat().st_mtime_ns) for p in root.rglob("*"))


@pytest.mark.slow
def test_sound_captures_are_read_without_a_word_more(sound, tmp_path):
    for name, root in sound.items():
        (tmp_path / name).mkdir()
        assert through_the_readers(root, tmp_path / name) == "sound", name


@pytest.mark.slow
@pytest.mark.skipif(ONLY is not None, reason="POLARFIELD_FUZZ_SEED repeats one number")
@settings(
    max_examples=TRIES, deadline=None, database=None, derandomize="POLARFIELD_FUZZ" not in os.environ, phases=(Phase.generate,),
    suppress_health_check=list(HealthCheck), print_blob=False,
)  # fmt: skip
@given(seed=st.integers(0, 2**48))
def test_whatever_is_wrong_is_a_sound_result_a_warning_or_one_line_that_names_the_file(sound, seed):
    attempt(seed, sound)


@pytest.mark.skipif(ONLY is None, reason="POLARFIELD_FUZZ_SEED is not set")
def test_one_number(sound):
    attempt(int(ONLY or 0), sound)
