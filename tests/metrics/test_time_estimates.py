"""Every stage tells what it and each of its passes take, of any kind of capture, so that whatever is left out has its price."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pipeline.capture import Capture, LightStage, LightStageCamera, LightTable, ViewSource
from pipeline.engine.costs import COMPILING, ITSELF
from pipeline.engine.plan import load_stages
from pipeline.formats.images import write_mask
from pipeline.geometry.cameras import Camera
from stages import STAGES, kept_kernels
from stages.object_share import USUAL, object_share

ROOT = Path(__file__).parents[2]
CAMERA = Camera(96, 64, 90.0, 90.0, 48.0, 32.0, np.eye(4))


def views(polarisation: str, count: int = 12, cameras: bool = True, camera: Camera = CAMERA, **more: object) -> Capture:
    sources = tuple(ViewSource(f"{k:02d}", (Path(f"{k}.exr"),), "a", lambda: None, (96, 64)) for k in range(count))
    known = {v.view: camera for v in sources} if cameras else None
    return Capture(Path("/nowhere"), "stokes", "multiview", polarisation, views=sources, cameras=known, **more)


def rig(cameras: int) -> Capture:
    frames = tuple(Path(f"{k}.exr") for k in range(40))
    lights = LightTable(np.zeros((40, 3)), np.zeros((40, 3)), np.ones(40), None)
    each = {f"cam{k:02d}": LightStageCamera(f"cam{k:02d}", frames, frames, None, CAMERA) for k in range(cameras)}
    stage = LightStage(Path("/nowhere"), each, lights)
    return Capture(Path("/nowhere"), "light_stage", "light_stage", "polarisers", light_stage=stage)


KINDS = {
    "stokes": views("stokes"), "polarisers": views("polarisers", masks={}), "plain": views("none", cameras=False),
    "few": views("none", 4), "one camera": rig(1), "three cameras": rig(3),
}  # fmt: skip


@pytest.mark.parametrize("kind", KINDS)
def test_whatever_a_plan_leaves_out_has_its_price(kind):
    capture = KINDS[kind]
    for name, stage in load_stages(STAGES).items():
        parameters = stage.parameters()
        decision, costs = stage.needed(capture, parameters), stage.costs(capture, parameters)
        assert costs[ITSELF].cpu_s > 0, name
        assert all(np.isfinite(c.cpu_s) and c.cpu_s >= 0 and c.memory_mb >= 0 for c in costs.values())
        left = {part for part, choice in decision.passes.items() if not choice.run}
        assert left <= set(costs), f"{name} does not tell what {left - set(costs)} would take"
        assert not set(costs) & {"train", *STAGES} and 0 <= stage.parallel <= 1
        del costs[ITSELF], decision
        assert COMPILING not in stage.needed(capture, parameters).passes


def test_training_takes_longer_with_more_steps_views_pixels_and_splats():
    stage = load_stages(STAGES)["train"]

    def seconds(capture: Capture = KINDS["stokes"], **changes: object) -> float:
        return stage.costs(capture, stage.parameters(**changes))[ITSELF].cpu_s

    assert seconds(iterations=4500) - seconds(iterations=3000) == pytest.approx(
        seconds(iterations=3000) - seconds(iterations=1500), rel=2e-3
    )
    assert seconds(views("stokes", 24)) > seconds() > seconds(max_splats=300) and seconds(mirror="split") < seconds()


def test_the_object_s_share_is_that_of_a_few_given_masks(tmp_path):
    paths = {}
    for k in range(9):
        mask = np.zeros((10, 10), bool)
        mask[:k] = True
        paths[f"{k:02d}"] = tmp_path / f"{k}.png"
        write_mask(paths[f"{k:02d}"], mask)
    assert object_share(views("stokes", 9, masks=paths)) == pytest.approx(np.mean([0, 2, 4, 6]) / 10, abs=0.1)
    assert object_share(views("stokes")) == USUAL
    paths["00"].write_bytes(b"no picture")
    assert 0 < object_share(views("stokes", 9, masks=dict(paths))) < 1


def test_kernels_still_to_be_compiled_are_counted_file_by_file(monkeypatch):
    kept: set[str] = set()
    monkeypatch.setattr(kept_kernels, "is_kept", kept.__contains__)
    for stage, files in kept_kernels.COMPILE_S.items():
        assert all("kernel" in (ROOT / file).read_text() for file in files), stage
        assert kept_kernels.compiling_s(stage) == pytest.approx(sum(files.values()))
        kept.update(list(files)[1:])
        assert kept_kernels.compiling_s(stage) == next(iter(files.values()))
    assert kept_kernels.compiling_s("poses") == 0
