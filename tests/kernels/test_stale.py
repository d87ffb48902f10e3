"""No kernel runs with the numbers of sources that have changed, in any package; what has not changed is not compiled again."""

from __future__ import annotations

import json

import pytest

from tests.kernels.conftest import Checkout, finished

pytestmark = pytest.mark.slow

EDITS = {  # a constant that the kernel takes from another file
    "capture": ("pipeline/formats/sample_kernels.py", "2.0**112)", "2.0**113)"),
    "shading": ("pipeline/optics/fresnel.py", "0.192029411", "0.392029411"),
    "rasteriser": ("stages/train/rasterize/constants.py", "\nALPHA_MAX = 0.99\n", "\nALPHA_MAX = 0.5\n"),
    "olat": ("pipeline/kernels/numerics.py", "LARGEST = np.float32(1e30)", "LARGEST = np.float32(0.5)"),
    "object file": ("stages/olat/probe.py", "SHARE = 0.25", "SHARE = 0.75"),
    "mesh": ("pipeline/geometry/probe.py", "SHARE = 0.25", "SHARE = 0.75"),
    "masks": ("stages/masks/probe.py", "SHARE = 0.25", "SHARE = 0.75"),
}
BEFORE = {"capture": 1.0, "shading": 0.9082, "rasteriser": 0.99, "olat": 1.0, "object file": 0.25, "mesh": 0.25, "masks": 0.25}
AFTER = {"capture": 2.0, "shading": 0.8082, "rasteriser": 0.5, "olat": 0.0, "object file": 0.75, "mesh": 0.75, "masks": 0.75}

PROBE = """
from {module} import TWICE

@kernel
def probe():
    return TWICE / 2
"""
OBJECT = """
from numba import carray, types
from pipeline.kernels.native import machine_code
from stages.olat.probe import SHARE

def probe(out):
    carray(out, 1)[0] = SHARE

def build():
    return machine_code(probe, (types.CPointer(types.float64),))
"""
CALLS = """
import json
from pathlib import Path
import numpy as np
from numba import njit
from pipeline.formats import exr_kernels
from pipeline.geometry import fusion_kernel
from pipeline.kernels import native
from pipeline.kernels.simd import spread, store
from pipeline.shading import shade_kernels
from stages.masks import volume
from stages.olat.pixel_fit import separation
from stages.train.rasterize import kernel_block

def capture():
    out, workspace = np.zeros((1, 1, 1), np.float32), np.zeros(1, np.float32)
    words = np.ones(1, np.float16).view(np.uint16)[None]
    exr_kernels.place_halves(words, workspace, workspace.view(np.uint32), np.zeros(1, np.int64), out)
    return out[0, 0, 0]

@njit
def _cap(out):
    store(out, 0, kernel_block.capped_alpha(np.float32(1), spread(np.float32(0))))

def rasteriser():
    out = np.zeros(16, np.float32)
    _cap(out)
    return out[0]

def olat():
    sample, fine = np.full(1, 0.25, np.float32), np.zeros(1, np.float32)
    separation._finite(sample, sample, sample, sample, sample, sample, fine)
    return fine[0]

def kept_object():
    out = np.zeros(1)
    built = []
    def build():
        from stages.olat.object_probe import build
        built.append(1)
        return build()
    native.kernel("probe", Path("stages/olat/object_probe.py").resolve(), ("pointer",), build)(out.ctypes.data)
    return out[0], len(built)

value, compiled = kept_object()
values = {
    "capture": capture(), "shading": shade_kernels._entering(np.float32(1.5))[0], "rasteriser": rasteriser(), "olat": olat(),
    "object file": value, "mesh": fusion_kernel.probe(), "masks": volume.probe(),
}
kernels = {
    "capture": exr_kernels.place_halves, "shading": shade_kernels._entering, "rasteriser": kernel_block.capped_alpha.twin(),
    "olat": separation._finite, "mesh": fusion_kernel.probe, "masks": volume.probe,
}
compilations = {name: sum(one.stats.cache_misses.values()) for name, one in kernels.items()} | {"object file": compiled}
print(json.dumps([{name: round(float(value), 4) for name, value in values.items()}, compilations]))
"""


@pytest.fixture(scope="module")
def checkout(tmp_path_factory) -> Checkout:
    """With one more kernel in mesh and in masks, whose own draw on no other file, and a small one kept as an object file."""
    made = Checkout(tmp_path_factory.mktemp("stale") / "checkout")
    for package, kernels in (("pipeline/geometry", "fusion_kernel"), ("stages/masks", "volume")):
        made.write(f"{package}/probe.py", "SHARE = 0.25\n")
        made.write(f"{package}/doubled.py", "from .probe import SHARE\n\nTWICE = 2 * SHARE\n")
        made.write(f"{package}/{kernels}.py", PROBE.format(module=f"{package.replace('/', '.')}.doubled"))
    made.write("stages/olat/probe.py", "SHARE = 0.25\n")
    made.write("stages/olat/object_probe.py", OBJECT)
    return made


@pytest.fixture(scope="module")
def runs(checkout) -> dict[str, tuple[dict[str, float], dict[str, int]]]:
    """What each process found: the value and the number of compilations of each kernel."""
    found = {"first": json.loads(checkout.run(CALLS))}
    found["second"] = json.loads(checkout.run(CALLS))
    for edit in EDITS.values():
        checkout.edit(*edit)
    both = [checkout.start(CALLS) for _ in range(2)]  # at once, and both must compile
    found["edited"], found["edited, beside it"] = (json.loads(finished(process)) for process in both)
    found["edited again"] = json.loads(checkout.run(CALLS))
    return found


@pytest.mark.parametrize("group", EDITS)
def test_a_changed_constant_of_another_file_is_computed_with(runs, group) -> None:
    assert [runs[r][0][group] for r in ("first", "second")] == [BEFORE[group]] * 2
    assert [runs[r][0][group] for r in ("edited", "edited, beside it", "edited again")] == [AFTER[group]] * 3


@pytest.mark.parametrize("group", EDITS)
def test_unchanged_sources_are_compiled_once(runs, group) -> None:
    assert runs["first"][1][group] == 1
    assert runs["edited"][1][group] + runs["edited, beside it"][1][group] in (1, 2)
    assert [runs[r][1][group] for r in ("second", "edited again")] == [0, 0]
