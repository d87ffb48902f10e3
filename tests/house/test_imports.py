"""Who imports whom: no circles, the ground knows no stage, no stage another, and tests stand on nothing but what they test."""

from __future__ import annotations

import ast
import re
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
DOCUMENTED = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)
PACKAGES = ("pipeline", "polarfield", "stages", "synth", "tests", "benchmarks")


def module_name(path: Path) -> str:
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


FILES = {module_name(p): p for package in PACKAGES for p in sorted((ROOT / package).rglob("*.py"))}


def imported_names(name: str, path: Path, tree: ast.Module) -> set[str]:
    """Every dotted name that a module imports, at its top or late, relative ones resolved."""
    package = name if path.name == "__init__.py" else name.rpartition(".")[0]
    found = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            base = package.split(".")[: len(package.split(".")) - node.level + 1] if node.level else []
            source = ".".join([*base, *([node.module] if node.module else [])])
            found |= {f"{source}.{alias.name}" for alias in node.names}
    return found


def resolved(name: str) -> str | None:
    """The module of this project that an imported name is, or is defined in."""
    while name:
        if name in FILES:
            return name
        name = name.rpartition(".")[0]
    return None


@cache
def import_graph() -> dict[str, set[str]]:
    """Module to the modules of this project that it imports."""
    graph = {}
    for name, path in FILES.items():
        names = imported_names(name, path, ast.parse(path.read_text(encoding="utf-8")))
        graph[name] = {target for target in map(resolved, names) if target and target != name}
    return graph


def circles(graph: dict[str, set[str]]) -> list[list[str]]:
    """The sets of modules that import each other round and round (Tarjan's strongly connected components of two or more)."""
    index: dict[str, int] = {}
    low: dict[str, int] = {}
    stack: list[str] = []
    found: list[list[str]] = []

    def visit(node: str) -> None:
        index[node] = low[node] = len(index)
        stack.append(node)
        for target in sorted(graph[node]):
            if target not in index:
                visit(target)
                low[node] = min(low[node], low[target])
            elif target in stack:
                low[node] = min(low[node], index[target])
        if low[node] == index[node]:
            members = stack[stack.index(node) :]
            del stack[stack.index(node) :]
            if len(members) > 1:
                found.append(sorted(members))

    for node in sorted(graph):
        if node not in index:
            visit(node)
    return found


def arrows(source: str, target: str) -> list[str]:
    """`a -> b` for every module under `source` that imports one under `target`."""
    return [
        f"{name} -> {other}"
        for name, others in sorted(import_graph().items())
        for other in sorted(others)
        if name.split(".")[0] == source and other.split(".")[0] == target
    ]


def stage_of(name: str) -> str | None:
    """The stage that a module of `stages` belongs to: `olat`, `poses`; None for what holds the stages together."""
    parts = name.split(".")
    for depth in (2, 3):
        if parts[0] == "stages" and len(parts) >= depth and (ROOT.joinpath(*parts[:depth]) / "stage.py").is_file():
            return parts[depth - 1]
    return None


STAGES = {stage_of(name) for name in FILES if name.startswith("stages.")} - {None}


def test_the_finder_of_circles_finds_one_of_three_and_none_in_a_chain():
    assert circles({"a": {"b"}, "b": {"c"}, "c": {"a"}, "d": {"a"}}) == [["a", "b", "c"]]
    assert circles({"a": {"b"}, "b": {"c"}, "c": set()}) == []


def test_every_stage_is_seen():
    assert {"decode", "poses", "masks", "olat", "train", "mesh", "relight", "metrics"} <= STAGES


def test_no_modules_import_each_other_in_a_circle_also_not_by_late_imports():
    assert circles(import_graph()) == []


@pytest.mark.parametrize("upper", ["polarfield", "stages", "synth", "tests", "benchmarks"])
def test_the_ground_imports_nothing_that_stands_on_it(upper):
    assert arrows("pipeline", upper) == []


def test_no_stage_imports_another():
    across = [
        f"{name} -> {other}"
        for name, others in sorted(import_graph().items())
        for other in sorted(others)
        if name.startswith("stages.") and (own := stage_of(name)) and (far := stage_of(other)) and own != far
    ]
    assert across == []


@pytest.mark.parametrize("source", ["polarfield", "stages", "synth"])
@pytest.mark.parametrize("target", ["tests", "benchmarks"])
def test_what_is_shipped_imports_neither_tests_nor_benchmarks(source, target):
    assert arrows(source, target) == []


def test_tests_import_neither_benchmarks_nor_each_other():
    assert arrows("tests", "benchmarks") == []
    files = [arrow for arrow in arrows("tests", "tests") if arrow.rpartition(".")[2].startswith("test_")]
    assert files == []
    scripts = [name for name in FILES if name.startswith("tests.") and SCRIPT.search(FILES[name].read_text(encoding="utf-8"))]
    assert scripts == []  # programs that tests start


SCRIPT = re.compile(r"^\s*[\"']?(?:from|import) benchmarks\b", re.MULTILINE)
STAGE_PATH = re.compile(r"\bstages[./](?!md\b)\w")


def named_stages(tree: ast.Module) -> list[str]:
    """Paths and modules of stages in strings (not in docstrings), and stages by which something is looked up or compared."""
    about = [node.body[0] for node in ast.walk(tree) if isinstance(node, DOCUMENTED) and node.body]
    prose = {id(first.value) for first in about if isinstance(first, ast.Expr)}
    found = []
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in prose:
            found += [node.value] if STAGE_PATH.search(node.value) else []
        keys: list[ast.expr] = []
        if isinstance(node, ast.Subscript):
            keys = [node.slice]
        elif isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and node.func.attr == "get":
            keys = node.args[:1]
        elif isinstance(node, ast.Compare):
            keys = [node.left, *node.comparators]
        found += [key.value for key in keys if isinstance(key, ast.Constant) and key.value in STAGES]
    return found


def test_names_of_stages_are_seen_in_look_ups_and_in_paths_but_not_in_prose():
    seen = named_stages(ast.parse('"""Of stages.mesh."""\na = inputs["mesh"]\nb = "train" in c\nd = "stages/olat"\n'))
    assert sorted(seen) == ["mesh", "stages/olat", "train"]


# One digest of the kernels' sources serves both: it reads folders of stages until it follows imports instead.
DIGESTS = ("pipeline.kernels.cache", "pipeline.kernels.compiling")


@pytest.mark.parametrize("name", sorted(n for n in FILES if n.split(".")[0] == "pipeline" and n not in DIGESTS))
def test_the_ground_names_no_stage(name):
    """What it needs of a stage is handed in."""
    assert named_stages(ast.parse(FILES[name].read_text(encoding="utf-8"))) == []
