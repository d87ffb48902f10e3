"""Small runs for crash points: tiny stages over a made-up capture, and the program's exact stages over three tiny pictures."""

from __future__ import annotations

import dataclasses
import json
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from pipeline.capture import Capture
from pipeline.engine import call as calls
from pipeline.engine import cli, places
from pipeline.engine.child import stage_command
from pipeline.engine.stage import Decision, Stage, StageRun


class Scene:
    """A capture, the stages over it, and what an undisturbed run leaves."""

    name = ""
    given = ""
    """PARAMS of every run."""
    other = ""
    """PARAMS that make a version besides."""

    def __init__(self, capture: Path, stages: dict[str, Stage], last: str) -> None:
        self.capture, self.stages = capture, stages
        self.program = calls.Program({}, module="none", report=last, inspect=lambda *a: Path())
        self.whole: dict[str, str] = {}

    def load(self, folder: Path) -> None:
        """Have this process load what a run loads, once for all its forks."""
        from forks import load_what_it_loads

        from pipeline.engine.costs.probe import slowness

        slowness()
        first = folder / f"{self.name}-first" / "d"
        first.mkdir(parents=True)
        load_what_it_loads(lambda: self.call("all", first) or self.call("plan", first), first.parent / "log")

    def call(self, command: str, dataset: Path, *more: str, parameters: str | None = None) -> int:
        """Run a command of the program in this process; a stage's own process is a fork."""
        cli.load_stages = lambda modules: self.stages  # this process is a fork of its own
        cli.run_stage = self.run_stage
        arguments = [command, str(self.capture), "--dataset", str(dataset), "--params", parameters or self.given, *more]
        return cli.main(self.program, arguments)

    def run_stage(self, call: calls.Call, name: str) -> int:
        """Make one stage as its own process does."""
        from forks import forked

        arguments = stage_command(call, name)[3:]  # what follows `python -m MODULE`
        return forked(lambda: cli.main(self.program, arguments), call.dataset.root.parent / "log")


@dataclass(frozen=True)
class Factor:
    factor: int = field(default=2)


def count(run: StageRun) -> None:
    """A file of a few kilobytes, a checkpoint before it."""
    (run.scratch / "half").write_text("half")
    (run.output / "inner").mkdir()
    (run.output / "inner" / "count.txt").write_text((run.capture.root / "number.txt").read_text() * 1000)


def double(run: StageRun) -> None:
    """Reads the first."""
    (run.output / "double.txt").write_text((run.inputs["count"] / "inner" / "count.txt").read_text() * 2)


def always(capture: Capture, parameters: object) -> Decision:
    return Decision(True, "always")


class Stub(Scene):
    """Two stages that cost nothing."""

    name = "stub"
    other = "count.factor=3"

    def __init__(self, folder: Path) -> None:
        folder.mkdir(parents=True)
        (folder / "number.txt").write_text("21")
        places.open_capture = lambda path: Capture(Path(path).absolute(), "numbers", "multiview", "none")
        stages = {
            "count": Stage("count", 1, Factor, (), always, count, lambda c: [c.root / "number.txt"]),
            "double": Stage("double", 1, Factor, ("count",), always, double),
        }
        super().__init__(folder, stages, "double")


def careless(run: StageRun) -> None:
    """Adds to what an earlier leg left, as no stage should."""
    with (run.scratch / "half").open("a") as stream:
        stream.write("21")
    (run.output / "count.txt").write_text((run.scratch / "half").read_text())


class Careless(Stub):
    """A stage that a stop does harm to: what the search for unmended stops must find."""

    name = "careless"

    def __init__(self, folder: Path) -> None:
        super().__init__(folder)
        self.stages = {"double": Stage("double", 1, Factor, (), always, careless, lambda c: [c.root / "number.txt"])}


VIEWS, SIDE = 3, 16


def write_views(folder: Path, views: int = VIEWS, side: int = SIDE) -> None:
    """Stokes images of a disc from some sides, with cameras and masks."""
    from pipeline.formats.images import write_png, write_stokes
    from synth.orbit import look_at, orbit

    y, x = (np.mgrid[:side, :side] + 0.5) / side * 2 - 1
    inside = np.hypot(x, y) < 0.7
    frames = []
    for number, position in enumerate(orbit(views, 5.0, 10, 50)):
        light = (0.3 + 0.1 * x + 0.05 * number) * inside
        stokes = np.stack([light, 0.2 * light * x, 0.2 * light * y], -1)[..., None] * np.array([1.0, 0.8, 0.6])
        write_stokes(folder / "images" / f"{number:03}.exr", stokes)
        write_png(folder / "masks" / f"{number:03}.png", np.where(inside, 255, 0).astype(np.uint8))
        files = {"file_path": f"images/{number:03}.exr", "mask_path": f"masks/{number:03}.png"}
        frames.append({**files, "transform_matrix": look_at(position).tolist()})
    shared = {"camera_model": "OPENCV", "fl_x": 1.875 * side, "fl_y": 1.875 * side}
    shared |= {"cx": side / 2, "cy": side / 2, "w": side, "h": side}
    (folder / "transforms.json").write_text(json.dumps({**shared, "frames": frames}))


class Real(Scene):
    """Decode, poses and masks, as they are."""

    name = "real"
    other = "masks.max_size=64"
    exact: tuple[str, ...] = ("decode", "poses", "masks")

    def write(self, folder: Path) -> None:
        """The capture."""
        write_views(folder)

    def __init__(self, folder: Path) -> None:
        from pipeline.capture import open_capture
        from pipeline.engine.plan import load_stages
        from stages import STAGES

        places.open_capture = open_capture
        from forks import forked

        # in a fork, as libraries' threads do not outlive one
        assert forked(lambda: self.write(folder) or 0, folder.parent / "written") == 0, (folder.parent / "written").read_text()
        exact = self.exact
        stages = load_stages({name: STAGES[name] for name in exact})
        for name, stage in stages.items():
            stages[name] = dataclasses.replace(stage, needs=tuple(n for n in stage.needs if n in exact))
        super().__init__(folder, stages, exact[-1])


class LightStage(Real):
    """The same with the fit of two cameras' frames of eight lights."""

    name = "stage"
    exact = ("decode", "poses", "masks", "olat")

    def write(self, folder: Path) -> None:
        """Frames of a ball from two cameras of one place."""
        from synth.ball import lights_csv, write_stage

        for camera in ("cam00", "cam01"):
            directions = write_stage(folder, camera=camera)
        (folder / "lights.csv").write_text(lights_csv(directions))
        shown = (folder / "cameras" / "camera00.txt").read_text()
        (folder / "cameras" / "camera01.txt").write_text(shown)


class Colmap(Real):
    """Decode, and cameras that COLMAP finds from pictures of a floor and two walls."""

    name = "colmap"
    given = "poses.features=500"
    other = "poses.features=450"
    exact = ("decode", "poses")

    def write(self, folder: Path) -> None:
        """The pictures: three textured unit squares, warped into each view."""
        import cv2

        from pipeline.formats.images import write_png

        rng = np.random.default_rng(5)
        grey = [rng.integers(30, 255, (60, 60, 3)).astype(np.uint8) for _ in range(3)]
        sheets = [cv2.resize(g, (360, 360), interpolation=cv2.INTER_CUBIC) for g in grey]
        focal, (width, height) = 380.0, (320, 240)
        for number in range(6):
            turn = np.radians(25 + 6 * number)
            towards = np.array([np.cos(turn), 0.55 + 0.05 * (number % 3), np.sin(turn)])
            position, z = 4.2 * towards + 0.5, -towards / np.linalg.norm(towards)
            x = np.cross(z, [0, 1, 0]) / np.linalg.norm(np.cross(z, [0, 1, 0]))
            pose = np.stack([x, np.cross(z, x), z])
            image = np.zeros((height, width, 3), np.uint8)
            for axis, sheet in enumerate(sheets):  # pixel (u, v) of a sheet lies at 2 (u, v) / 360 along two axes
                across, down = np.roll(np.eye(3), axis, 0)[:2] * 2 / 360
                plane = pose @ np.stack([across, down, -position], 1)
                intrinsics = np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]])
                warped = cv2.warpPerspective(sheet, intrinsics @ plane, (width, height), flags=cv2.INTER_AREA)
                image = np.where(warped.any(-1, keepdims=True), warped, image)
            write_png(folder / "images" / f"{number:03}.png", image)


class Trained(Scene):
    """A capture of eight views for every stage, by the program itself."""

    name = "trained"

    def write(self, folder: Path) -> None:
        """The capture."""
        write_views(folder, 8, 32)

    def __init__(self, folder: Path) -> None:
        from forks import forked

        from stages.__main__ import PROGRAM

        assert forked(lambda: self.write(folder) or 0) == 0
        super().__init__(folder, {}, "metrics")
        self.program = PROGRAM


class Fitted(Trained):
    """A light stage's."""

    name = "fitted"
    write = LightStage.write


SCENES = {scene.name: scene for scene in (Stub, Real, LightStage, Colmap, Trained, Fitted, Careless)}
