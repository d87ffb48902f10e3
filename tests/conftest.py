"""How a run on several cores shares out the tests: whole files, those that take longest first.

A file's tests stay in one process, so what they share (a training, a dataset, compiled kernels) is made once. Where
single tests were handed out, both processes trained and compiled the same.
"""

from __future__ import annotations

import atexit
import gc
import os

import pytest

if "PYTEST_XDIST_WORKER" in os.environ:
    # To take torch, numba and LLVM down piece by piece costs a worker seconds after its last test, for nothing: it is done.
    # Registered before all that is imported below, so what those have to tidy up comes first.
    atexit.register(os._exit, 0)

FOLDERS = ("tests/end_to_end",)  # their files share the datasets of `conftest.py` there: they stay together too
LONGEST = (
    "tests/end_to_end",
    "tests/olat/test_recovery.py",
    "tests/train/test_scales.py",
    "tests/olat/test_solvers.py",
    "tests/engine/test_cluster.py",
    "tests/calib/test_poses.py",
    "tests/capture/test_fuzz.py",
    "tests/kernels/test_stale.py",
    "tests/train/test_training.py",
    "tests/train/test_concavity.py",
    "tests/engine/test_interrupts.py",
    "tests/train/test_openings.py",
    "tests/crash",
    "tests/mesh/test_rig_surface.py",
    "tests/train/test_device.py",
    "tests/train/test_indirect.py",
)
"""From minutes of processor time down to a quarter of one: begun last, one of them would keep a single core at work. Neighbours
here run at the same time, so they are such that do not compile the same kernels."""


def unit_of(test: str) -> str:
    """The folder or file whose tests stay together, from a test's address (`tests/masks/test_worlds.py::test_...`)."""
    file = test.partition("::")[0]
    return next((folder for folder in FOLDERS if file.startswith(f"{folder}/")), file)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Put the longest first; files and tests keep their order otherwise."""
    rank = {name: place for place, name in enumerate(LONGEST)}

    def place(item: pytest.Item) -> int:
        file = item.nodeid.partition("::")[0]
        return rank.get(file, rank.get(file.rpartition("/")[0], len(rank)))

    items.sort(key=place)


def pytest_collection_finish() -> None:
    """Spare the garbage collector what is imported and collected: none of it goes before the end."""
    gc.freeze()


def pytest_unconfigure() -> None:
    """At its end OpenImageIO complains of what was not collected."""
    gc.unfreeze()


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: object) -> object | None:
    """xdist's `--dist loadfile`, by `unit_of` and in the order of the collection; its others as they are."""
    if config.getoption("dist") != "loadfile":
        return None
    from xdist.scheduler import LoadFileScheduling

    class Scheduling(LoadFileScheduling):
        def _split_scope(self, nodeid: str) -> str:
            return unit_of(nodeid)

    config.option.loadscopereorder = False
    return Scheduling(config, log)
