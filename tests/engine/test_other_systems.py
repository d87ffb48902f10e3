"""What Linux alone has (files in memory, bound cores, /proc, handles of processes) is done without where it is missing."""

from __future__ import annotations

import subprocess
import sys
from types import SimpleNamespace

import numpy as np

from pipeline.engine.batch import side_by_side
from pipeline.engine.dataset import usage
from pipeline.formats import image_output
from pipeline.formats.images import read_image, write_png

WITHOUT = """
import ctypes, os, sys
for name in ("memfd_create", "sched_getaffinity", "pidfd_open"):
    delattr(os, name)
ctypes.CDLL = lambda name: object()
from stages.__main__ import main
from pipeline.cores import usable_cores
from pipeline.engine.batch import side_by_side
from pipeline.engine.interrupts import in_child
in_child()
assert usable_cores() == os.cpu_count() and not side_by_side.PROCESSES_CAN_BE_WAITED_FOR
sys.argv[1:] = ["plan", sys.argv[1], "--dataset", sys.argv[2]]
sys.exit(main())
"""


def test_a_capture_is_planned_where_linux_calls_are_missing(tmp_path):
    frames = tmp_path / "capture" / "images"
    for k in range(3):
        write_png(frames / f"v{k}.png", np.full((16, 16, 3), 0.2 + 0.1 * k))
    run = [sys.executable, "-c", WITHOUT, str(frames.parent), str(tmp_path / "dataset")]
    done = subprocess.run(run, capture_output=True, text=True, timeout=120)
    assert done.returncode in (0, 2) and "Traceback" not in done.stderr, done.stderr


def test_pictures_are_the_same_without_files_in_memory(tmp_path, monkeypatch):
    pixels = np.random.default_rng(1).random((9, 7, 3))
    write_png(tmp_path / "a.png", pixels, bits=16)
    monkeypatch.delattr(image_output.os, "memfd_create")
    write_png(tmp_path / "b.png", pixels, bits=16)
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()
    assert read_image(tmp_path / "b.png").shape == (9, 7, 3)


def test_a_picture_cut_short_by_a_full_disk_is_told_without_files_in_memory(tmp_path):
    def cut(name: str) -> bool:
        write_png(name, np.random.default_rng(1).random((32, 32, 3)))
        with open(name, "r+b") as stream:
            stream.truncate(1500)
        return True

    assert not image_output._in_temporary_folder(cut, tmp_path / "x.png") and not list(tmp_path.iterdir())


def test_memory_is_measured_without_proc(tmp_path, monkeypatch):
    known = usage._own_peak_bytes()
    monkeypatch.setattr(usage, "PROCESSES", tmp_path / "none")
    assert 0.5 * known < usage._own_peak_bytes() <= 2 * known
    assert usage._resident_bytes() >= usage._own_peak_bytes()


def test_ended_processes_are_found_without_their_handles(monkeypatch):
    monkeypatch.setattr(side_by_side, "PROCESSES_CAN_BE_WAITED_FOR", False)
    monkeypatch.setattr(side_by_side, "LOOK_AGAIN_S", 0.01)
    scheduler = side_by_side.SideBySide([], 2, 1e3, None, None)  # type: ignore[arg-type]
    brief, long = (subprocess.Popen([sys.executable, "-c", f"import time; time.sleep({s})"]) for s in (0, 60))
    scheduler.running = {p.pid: SimpleNamespace(process=p) for p in (brief, long)}  # type: ignore[misc]
    try:
        assert [work.process for work in scheduler._ended()] == [brief]
        assert list(scheduler.running) == [long.pid]
    finally:
        long.kill()
        long.wait()
