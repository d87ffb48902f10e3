"""A checkout of its own: the sources alone, nothing compiled."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


class Checkout:
    """A copy of the sources in a folder."""

    def __init__(self, root: Path) -> None:
        self.root = root
        for package in ("pipeline", "stages"):
            shutil.copytree(ROOT / package, root / package, ignore=lambda _, names: [n for n in names if n == "__pycache__"])
        shutil.copy(ROOT / "pyproject.toml", root)

    @property
    def code(self) -> Path:
        """Where what it compiles is kept."""
        return self.root / "pipeline/kernels/__pycache__/machine_code"

    def edit(self, file: str, old: str, new: str) -> None:
        """Replace text that occurs once."""
        text = (self.root / file).read_text()
        assert text.count(old) == 1, f"{file}: {old!r} occurs {text.count(old)} times"
        (self.root / file).write_text(text.replace(old, new))

    def write(self, file: str, text: str) -> None:
        """Write a new file, or add to one."""
        with (self.root / file).open("a") as out:
            out.write(text)

    def start(self, code: str, **environment: str) -> subprocess.Popen[str]:
        """Run Python code against this checkout."""
        variables = {k: v for k, v in os.environ.items() if not k.startswith("NUMBA_")}
        variables |= {"PYTHONPATH": str(self.root), "OMP_NUM_THREADS": "1", **environment}
        pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
        return subprocess.Popen([sys.executable, "-c", code], cwd=self.root, env=variables, **pipes)

    def run(self, code: str, **environment: str) -> str:
        """What the code prints."""
        return finished(self.start(code, **environment))


def finished(process: subprocess.Popen[str]) -> str:
    """What a process printed."""
    out, err = process.communicate(timeout=300)
    assert process.returncode == 0, err
    return out.strip()


@pytest.fixture
def checkout(tmp_path) -> Checkout:
    return Checkout(tmp_path / "checkout")
