"""What a Python source says, read from its syntax tree and remembered by its content. Does not load numba."""

from __future__ import annotations

import ast
import contextlib
import functools
import hashlib
import json
import os
import sys
import tempfile
from pathlib import Path
from typing import NamedTuple

from pipeline.kernels.storage import place

_MOST = 2000  # sources remembered
_FILE = f"sources-py{sys.version_info[0]}{sys.version_info[1]}.json"  # syntax trees differ among versions of Python


class Import(NamedTuple):
    """One imported thing: dots before the module's name, that name, and what is taken from it ("": the module alone)."""

    level: int
    module: str
    name: str


class Facts(NamedTuple):
    """Everything that a source imports, and the digest of its syntax tree without docstrings."""

    imports: tuple[Import, ...]
    digest: str


def read_facts(file: Path) -> Facts:
    """Facts of the source `file` as it was when this process first asked."""
    return _memory()[file]


def remember() -> None:
    """Keep what was found for other processes."""
    _memory().save()


def facts_of(source: bytes) -> Facts:
    """Facts of a source; of one that Python cannot read, no imports and the digest of its bytes."""
    try:
        tree = ast.parse(source)
    except (SyntaxError, ValueError):
        return Facts((), hashlib.sha256(source).hexdigest()[:32])
    imports = tuple(dict.fromkeys(_imports(tree)))
    for node in ast.walk(tree):
        if isinstance(body := getattr(node, "body", None), list):  # strings that stand alone do nothing
            node.body = [s for s in body if not (isinstance(s, ast.Expr) and isinstance(s.value, ast.Constant))]  # type: ignore[attr-defined]
    return Facts(imports, hashlib.sha256(ast.dump(tree).encode()).hexdigest()[:32])


def _imports(node: ast.AST) -> list[Import]:
    """In functions too: they may be called while a module is imported."""
    if isinstance(node, ast.Import):
        return [Import(0, alias.name, "") for alias in node.names]
    if isinstance(node, ast.ImportFrom):
        return [Import(node.level, node.module or "", alias.name) for alias in node.names]
    if isinstance(node, ast.If) and ast.unparse(node.test) in ("TYPE_CHECKING", "typing.TYPE_CHECKING"):
        return [found for child in node.orelse for found in _imports(child)]
    return [found for child in ast.iter_child_nodes(node) for found in _imports(child)]


class _Memory(dict[Path, Facts]):
    """Facts by file for this process, by content for all."""

    def __init__(self, kept: Path | None) -> None:
        super().__init__()
        self.kept = kept
        self.known: dict[str, Facts] = {}
        self.used: dict[str, Facts] = {}
        self.grown = False
        with contextlib.suppress(OSError, ValueError, TypeError, AttributeError):  # none yet, or a damaged one
            entries = json.loads(kept.read_text()) if kept is not None else {}
            self.known = {k: Facts(tuple(Import(*i) for i in imports), digest) for k, (imports, digest) in entries.items()}

    def __missing__(self, file: Path) -> Facts:
        source = file.read_bytes()
        key = hashlib.sha256(source).hexdigest()[:32]
        facts = self.known.get(key)
        if facts is None:
            facts = facts_of(source)
            self.grown = True
        self.used[key] = self[file] = facts
        return facts

    def save(self) -> None:
        """In one step, so that no other process reads half of it; what two processes find at once, one of them finds again."""
        if not self.grown or self.kept is None:
            return
        self.grown = False
        self.known = {**(self.known if len(self.known) < _MOST else {}), **self.used}
        with contextlib.suppress(OSError), tempfile.TemporaryDirectory(dir=self.kept.parent) as aside:
            file = Path(aside) / _FILE
            file.write_text(json.dumps(self.known))
            os.replace(file, self.kept)


@functools.cache
def _memory() -> _Memory:
    folder = place()
    return _Memory(folder / _FILE if folder is not None else None)
