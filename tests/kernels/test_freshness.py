"""Which sources a kernel's digest covers."""

from __future__ import annotations

import ast
import json
import re
from pathlib import Path

import pytest

from pipeline.kernels import freshness
from pipeline.kernels.source_facts import facts_of
from stages.olat.pixel_fit import many_pixels
from stages.olat.reading import zip_frames
from tests.kernels.conftest import ROOT

OLAT = f"""
from pathlib import Path
from pipeline.kernels import freshness
for file in ({", ".join(repr(str(source.SOURCE.relative_to(ROOT))) for source in (many_pixels, zip_frames))}):
    print(freshness.digest(Path(file)))
"""


@pytest.fixture
def package(tmp_path) -> Path:
    """A package that another project might have: `kernels.py` and what it imports."""
    sources = {
        "__init__.py": "",
        "kernels.py": "from .near import NEAR\nfrom pkg.group import NAME\ndef f():\n    from . import late\n",
        "near.py": "import pkg.far\nimport typing\nif typing.TYPE_CHECKING:\n    from pkg import types_only\nNEAR = 1\n",
        "far.py": "import numpy as np\nfrom pipeline.optics import fresnel\n",
        "late.py": "",
        "types_only.py": "",
        "unrelated.py": "",
        "group/__init__.py": "from .inner import NAME\n",
        "group/inner.py": "NAME = 1\n",
    }
    for name, text in sources.items():
        path = tmp_path / "pkg" / name
        path.parent.mkdir(exist_ok=True)
        path.write_text(text)
    return tmp_path / "pkg"


def test_a_digest_covers_what_a_file_imports_directly_or_not(package) -> None:
    found = {str(s.relative_to(package)) for s in freshness.sources(package / "kernels.py") if s.is_relative_to(package)}
    assert found == {"kernels.py", "near.py", "far.py", "late.py", "group/__init__.py", "group/inner.py"}
    assert ROOT / "pipeline/optics/fresnel.py" in freshness.sources(package / "kernels.py")


def test_libraries_that_lie_beside_the_package_are_not_followed(package) -> None:
    for library in ("numpy", "numba"):  # as in site-packages
        (package.parent / library).mkdir()
        (package.parent / library / "__init__.py").write_text("")
    assert not any("numpy" in source.parts for source in freshness.sources(package / "kernels.py"))
    assert package / "far.py" in freshness.sources(package / "kernels.py")


@pytest.mark.parametrize(
    ("text", "same"),
    [
        ("# why\nA = 1  # what\n\n\ndef f():\n    return A\n", True),
        ('"""Module."""\nA = 1\n"""Of A."""\n\ndef f():\n    """Of f."""\n    return A\n', True),
        ("A = 2\ndef f():\n    return A\n", False),
        ("A = 1\ndef f():\n    return -A\n", False),
        ("A = 1.0\ndef f():\n    return A\n", False),
    ],
)
def test_only_what_python_runs_counts(text, same) -> None:
    assert (facts_of(text.encode()).digest == facts_of(b"A = 1\ndef f():\n    return A\n").digest) == same


@pytest.mark.slow
@pytest.mark.parametrize(
    "file", ["pipeline/kernels/numerics.py", "stages/olat/pixel_fit/fit_options.py", "pipeline/kernels/native.py"]
)
def test_object_files_go_by_the_same_digest_in_every_checkout_until_a_source_changes(checkout, file) -> None:
    ours = [freshness.digest(source.SOURCE) for source in (many_pixels, zip_frames)]
    assert checkout.run(OLAT).split() == ours
    checkout.write(file, "\nLIMIT = 1\n")
    fit, unpack = checkout.run(OLAT).split()
    assert fit != ours[0]
    assert (unpack != ours[1]) == (file == "pipeline/kernels/native.py")  # it draws on nothing else here


def test_numbas_settings_count_unless_they_leave_the_code_alone(checkout) -> None:
    plain = checkout.run(OLAT)
    assert checkout.run(OLAT, NUMBA_NUM_THREADS="1", NUMBA_DEBUG_CACHE="0") == plain
    assert checkout.run(OLAT, NUMBA_OPT="1") != plain


@pytest.mark.slow
def test_a_damaged_memory_of_sources_is_made_anew(checkout) -> None:
    plain = checkout.run(OLAT)
    (memory,) = checkout.code.glob("sources-*.json")
    whole = json.loads(memory.read_text())
    for damaged in (memory.read_text()[:-20], '{"a": 1}'):
        memory.write_text(damaged)
        assert checkout.run(OLAT) == plain
        assert json.loads(memory.read_text()) == whole


def test_every_compiled_function_is_a_kernel() -> None:
    """Nothing but this package asks numba to compile."""
    compilers = {"njit", "jit", "cfunc", "vectorize", "guvectorize", "stencil", "generated_jit"}
    bare = []
    for file in (*ROOT.glob("pipeline/**/*.py"), *ROOT.glob("stages/**/*.py")):
        if file == ROOT / "pipeline/kernels/compiling.py" or b"numba" not in file.read_bytes():
            continue
        for node in ast.walk(ast.parse(file.read_bytes())):
            taken = isinstance(node, ast.ImportFrom) and (node.module or "").partition(".")[0] == "numba"
            names = {alias.name for alias in node.names} if taken else set()
            if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id in ("numba", "nb"):
                names = {node.attr}
            bare += [f"{file.relative_to(ROOT)}:{node.lineno}" for _ in names & compilers]
    assert bare == []


def test_the_tests_that_tie_kernels_to_their_formulas_exist() -> None:
    named = re.findall(r"`(tests/[\w/]+\.py)::(\w+)`", (ROOT / "docs/adding.md").read_text())
    assert len(named) > 10
    assert [f"{file}::{test}" for file, test in named if f"def {test}(" not in (ROOT / file).read_text()] == []


def test_the_command_line_does_without_numba(checkout) -> None:
    code = "import sys, stages.__main__, pipeline.kernels.native; print('numba' in sys.modules)"
    assert checkout.run(code) == "False"
