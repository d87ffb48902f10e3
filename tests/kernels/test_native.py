"""Machine code kept on disk: run without numba, compiled again where it is not whole, refused where it needs a runtime."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from numba import carray, types

from pipeline.kernels import native


def _double(count, numbers):
    values = carray(numbers, count)
    for k in range(count):
        values[k] *= 2.0


def _copies(count, numbers):
    carray(numbers, count)[:] = np.zeros(count)


def _run(name, build):
    values = np.arange(4.0)
    native.kernel(name, Path(__file__), ("int64", "pointer"), build)(4, values.ctypes.data)
    return values.tolist()


def test_kept_code_is_used_and_damaged_code_is_compiled_again(tmp_path, monkeypatch):
    monkeypatch.setattr(native, "_place", lambda name, source: tmp_path / "double.o")
    compiled = []

    def build():
        compiled.append(1)
        return native.machine_code(_double, (types.int64, types.CPointer(types.float64)))

    for name in ("fresh", "kept"):
        assert _run(name, build) == [0, 2, 4, 6]
    assert len(compiled) == 1
    whole = (tmp_path / "double.o").read_bytes()
    (tmp_path / "double.o").write_bytes(whole[:-100])
    assert _run("damaged", build) == [0, 2, 4, 6]
    assert _run("mended", build) == [0, 2, 4, 6]
    assert len(compiled) == 2


@pytest.mark.slow
def test_a_kernel_with_arrays_of_its_own_is_refused():
    with pytest.raises(TypeError, match="needs numba"):
        native.machine_code(_copies, (types.int64, types.CPointer(types.float64)))


@pytest.mark.slow
def test_the_olat_fit_runs_without_numba_once_it_is_compiled():
    code = (
        "import sys, numpy as np\n"
        "from pipeline.capture.config import OlatConfig\n"
        "from stages.olat.parameters import OlatParameters\n"
        "from stages.olat.pixel_fit.many_pixels import fit\n"
        "from stages.olat.run import settings_of\n"
        "from synth.olat_pixels import make, rig_of\n"
        "settings = settings_of(OlatParameters(), OlatConfig(), np.inf)\n"
        "p = make(20, rig=rig_of(60))\n"
        "rows, _ = fit(p.cross.astype('f4'), p.parallel.astype('f4'), p.view, p.rig, settings)\n"
        "assert np.isfinite(rows).all()\n"
        "print([m for m in ('numba', 'scipy', 'jax', 'torch') if m in sys.modules])\n"
    )
    for _ in range(2):  # the first may compile
        done = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True)
    assert done.stdout.strip() == "[]"
