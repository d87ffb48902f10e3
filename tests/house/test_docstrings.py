"""What one room takes from another says in its docstring all that its caller needs: no one reads the body to call it.

A room is a folder below `pipeline`, `stages` or `synth` (or a file there). The model is `rasterize` in stages/train/rasterize.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import NamedTuple

import pytest

ROOT = Path(__file__).parents[2]
PACKAGES = ("pipeline", "stages", "synth")
SECTIONS = ("Args", "Fields", "Returns", "Yields", "Raises", "Source")
ARRAY = re.compile(r"\b(ndarray|NDArray|Tensor|ArrayLike)\b")
SHAPE = re.compile(r"\[[^\]]*\]|\bany shape\b")
FAULTS = ("UserError", "ValueError")

Definition = ast.FunctionDef | ast.ClassDef


def module_name(path: Path) -> str:
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


@cache
def trees() -> dict[str, tuple[Path, ast.Module, str]]:
    """Module to its file, syntax tree and text."""
    found = {}
    for path in (p for package in PACKAGES for p in sorted((ROOT / package).rglob("*.py"))):
        text = path.read_text(encoding="utf-8")
        found[module_name(path)] = (path, ast.parse(text), text)
    return found


@pytest.fixture(scope="module", autouse=True)
def _forget() -> Iterator[None]:
    """Millions of syntax nodes that stay would slow down what this process tests next: the garbage collector visits them."""
    yield
    for kept in (trees, names_of, definitions):
        kept.cache_clear()


def room(module: str) -> str:
    return ".".join(module.split(".")[:2])


class Names(NamedTuple):
    """What a module names: local name to (module, name) of what it imports with `from`, at its top or late; and the
    (name, attribute) of every attribute that it takes of a name."""

    imports: dict[str, tuple[str, str]]
    attributes: set[tuple[str, str]]


@cache
def names_of(module: str) -> Names:
    path, tree, _ = trees()[module]
    package = module if path.name == "__init__.py" else module.rpartition(".")[0]
    found = Names({}, set())
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom):
            base = package.split(".")[: len(package.split(".")) - node.level + 1] if node.level else []
            source = ".".join([*base, *([node.module] if node.module else [])])
            found.imports.update({alias.asname or alias.name: (source, alias.name) for alias in node.names})
        elif isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
            found.attributes.add((node.value.id, node.attr))
    return found


@cache
def definitions(module: str) -> dict[str, Definition]:
    """Name to the functions and classes of a module's top level."""
    return {node.name: node for node in trees()[module][1].body if isinstance(node, Definition)}


def defined(module: str, name: str, seen: frozenset[tuple[str, str]] = frozenset()) -> tuple[str, str] | None:
    """Where a name of a module is a function or a class, re-exports followed; None for anything else."""
    if module not in trees() or (module, name) in seen:
        return None
    if name in definitions(module):
        return module, name
    source = names_of(module).imports.get(name)
    return defined(*source, seen | {(module, name)}) if source else None


def used_elsewhere() -> set[tuple[str, str]]:
    """(module, name) of every public function and class that a module of another room names: imported, or by its module."""
    found = set()
    for module in trees():
        names = names_of(module)
        by_module = {(".".join(names.imports[name]), part) for name, part in names.attributes if name in names.imports}
        places = {defined(*each) for each in by_module.union(names.imports.values())} - {None}
        found |= {place for place in places if room(place[0]) != room(module) and not place[1].startswith("_")}
    return found


def sections(text: str) -> dict[str, str]:
    """Section to what stands below its headline, of a cleaned docstring."""
    parts = re.split(rf"^({'|'.join(SECTIONS)}):[ \t]*", text, flags=re.MULTILINE)
    return dict(zip(parts[1::2], parts[2::2]))


def entries(section: str) -> dict[str, str]:
    """Name to its description, of lines `name: text`, `a, b: text`; what is indented further belongs to the name above."""
    lines = [line for line in section.splitlines() if line.strip()]
    depth = min((len(line) - len(line.lstrip()) for line in lines), default=0)
    found: dict[str, str] = {}
    names: list[str] = []
    for line in lines:
        head = re.match(r"\s*(\*{0,2}\w+(?:, \*{0,2}\w+)*):", line) if len(line) - len(line.lstrip()) == depth else None
        if head:
            names = [name.strip("* ") for name in head[1].split(",")]
            line = line[head.end() :]
        for name in names:
            found[name] = found.get(name, "") + line
    return found


def arguments(function: ast.FunctionDef) -> list[ast.arg]:
    every = function.args
    extra = [arg for arg in (every.vararg, every.kwarg) if arg]
    named = [*every.posonlyargs, *every.args, *every.kwonlyargs, *extra]
    return [arg for arg in named if arg.arg not in ("self", "cls") and not arg.arg.startswith("_")]


def described(arg: str, annotation: ast.expr | None, texts: dict[str, str]) -> list[str]:
    """What is missing of an argument's or a field's description."""
    if not texts.get(arg, "").strip():
        return [f"{arg} is not described"]
    array = annotation is not None and ARRAY.search(ast.unparse(annotation))
    return [f"{arg} has no [shape]"] if array and not SHAPE.search(texts[arg]) else []


def own_nodes(node: ast.AST) -> Iterator[ast.AST]:
    """Every node below one, but for what stands in a function within it."""
    for child in ast.iter_child_nodes(node):
        if not isinstance(child, ast.FunctionDef | ast.Lambda):
            yield child
            yield from own_nodes(child)


def raised(function: ast.FunctionDef) -> set[str]:
    """The project's and Python's errors of input that a body raises itself (not what it calls)."""
    calls = [n.exc.func for n in own_nodes(function) if isinstance(n, ast.Raise) and isinstance(n.exc, ast.Call)]
    return {call.id for call in calls if isinstance(call, ast.Name)} & set(FAULTS)


def function_faults(function: ast.FunctionDef, text: str) -> list[str]:
    """What is missing of a function's docstring."""
    parts = sections(text)
    texts = entries(parts.get("Args", ""))
    faults = [fault for arg in arguments(function) for fault in described(arg.arg, arg.annotation, texts)]
    gives = any(isinstance(node, ast.Return) and node.value for node in own_nodes(function))
    returns = ast.unparse(function.returns) if function.returns else str(gives or None)
    if returns not in ("None", "NoReturn"):
        outcome = parts.get("Returns", "") + parts.get("Yields", "")
        if not outcome.strip():
            faults.append("no Returns")
        elif ARRAY.search(returns) and not SHAPE.search(outcome):
            faults.append("Returns has no [shape]")
    return faults + [f"{error} is not in Raises" for error in raised(function) if error not in parts.get("Raises", "")]


def beneath(body: list[ast.stmt], lines: list[str]) -> dict[str, str]:
    """Field to the string beneath it or the comment beside it."""
    found = {}
    for node, after in zip(body, [*body[1:], None]):
        if isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
            text = lines[(node.end_lineno or node.lineno) - 1].partition("  # ")[2]
            if isinstance(after, ast.Expr) and isinstance(after.value, ast.Constant):
                text += str(after.value.value)
            found[node.target.id] = text
    return found


def class_faults(node: ast.ClassDef, text: str, lines: list[str]) -> list[str]:
    """What is missing of a class's docstring, its fields' strings or its constructor's."""
    constructor = next((n for n in node.body if isinstance(n, ast.FunctionDef) and n.name == "__init__"), None)
    parts = sections(text) | sections(ast.get_docstring(constructor) or "" if constructor else "")
    texts = entries(parts.get("Args", "")) | entries(parts.get("Fields", ""))
    if constructor is not None:
        return [fault for arg in arguments(constructor) for fault in described(arg.arg, arg.annotation, texts)]
    texts = {name: beside or texts.get(name, "") for name, beside in beneath(node.body, lines).items()}
    fields = [n for n in node.body if isinstance(n, ast.AnnAssign) and isinstance(n.target, ast.Name)]
    public = [n for n in fields if not n.target.id.startswith("_") and not ast.unparse(n.annotation).startswith("ClassVar")]
    return [fault for n in public for fault in described(n.target.id, n.annotation, texts)]


def faults_of(node: Definition, lines: list[str]) -> list[str]:
    """What is missing of a definition's docstring."""
    text = ast.get_docstring(node) or ""
    if not text.splitlines() or not text.splitlines()[0].strip():
        return ["no docstring"]
    return class_faults(node, text, lines) if isinstance(node, ast.ClassDef) else function_faults(node, text)


def all_faults() -> dict[str, list[str]]:
    """FILE:NAME to what is missing, of everything that another room uses."""
    found = {}
    for module, name in sorted(used_elsewhere()):
        path, _, text = trees()[module]
        if faults := faults_of(definitions(module)[name], text.splitlines()):
            found[f"{path.relative_to(ROOT)}:{name}"] = faults
    return found


@pytest.mark.slow
def test_what_another_room_uses_says_what_goes_in_and_comes_out():
    faults = all_faults()
    assert not faults, "\n" + "\n".join(f"{place}: {'; '.join(what)}" for place, what in faults.items())


COMPLETE = '''
def f(light: np.ndarray, n: int = 3) -> np.ndarray:
    """Do it.

    Args:
        light: radiance. [H, W]
        n: rounds.

    Returns:
        Sums. [H]

    Raises:
        UserError: n is not positive.
    """
    if n < 1:
        raise UserError("n")
'''


@pytest.mark.parametrize(
    ("cut", "fault"),
    [
        ("", None),
        ("        n: rounds.\n", "n is not described"),
        (" [H, W]", "light has no [shape]"),
        (" [H]", "Returns has no [shape]"),
        ("    Returns:\n        Sums. [H]\n", "no Returns"),
        ("        UserError: n is not positive.\n", "UserError is not in Raises"),
    ],
)
def test_a_gap_in_a_docstring_is_found(cut, fault):
    source = COMPLETE.replace(cut, "") if cut else COMPLETE
    node = ast.parse(source).body[0]
    assert faults_of(node, source.splitlines()) == ([fault] if fault else [])


def test_a_field_is_described_by_its_docstring_a_string_beneath_or_a_comment_beside():
    described = 'class A(NamedTuple):\n    """Three.\n\n    Fields:\n        a: one.\n    """\n\n'
    source = described + "    a: int\n    b: int  # two\n    c: int\n"
    assert faults_of(ast.parse(source).body[0], source.splitlines()) == ["c is not described"]
    source += '    "three"\n'
    assert faults_of(ast.parse(source).body[0], source.splitlines()) == []
