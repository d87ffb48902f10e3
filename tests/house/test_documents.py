"""What the documents name is there: files, folders, tests, modules, what these define, and stages' parameters."""

from __future__ import annotations

import ast
import re
from dataclasses import fields
from functools import cache
from pathlib import Path
from typing import Literal, get_args, get_origin, get_type_hints

import pytest

from pipeline.engine.plan import load_stages
from stages import STAGES

ROOT = Path(__file__).parents[2]
PACKAGES = ("pipeline", "polarfield", "stages", "synth", "tests", "benchmarks")
DOCUMENTS = sorted([*ROOT.glob("*.md"), *ROOT.glob("docs/*.md"), *ROOT.glob("stages/**/README.md")])
SOURCES = [p for package in PACKAGES for p in sorted((ROOT / package).rglob("*.py"))]
PLACES = {str(p.relative_to(ROOT)) for package in PACKAGES for p in (ROOT / package).rglob("*") if "__pycache__" not in p.parts}
"""Every file and folder of the packages, from the root."""
MODULES: dict[str, list[Path]] = {}
for source in SOURCES:
    MODULES.setdefault(source.parent.name if source.name == "__init__.py" else source.stem, []).append(source)
MODULES["run"] = [ROOT / "pipeline" / "engine" / "stage.py"]  # `run.output` is of the StageRun that a stage gets

LINK = re.compile(r"\]\(([^)#\s]+)[^)]*\)")
TICKED = re.compile(r"`([^`\n]+)`")
ROOTED_PATH = re.compile(rf"(?<![\w./-])(?:{'|'.join((*PACKAGES, 'docs', 'tools'))})/[\w./*]*")
ROOTED_NAME = re.compile(rf"(?<![\w./-])(?:{'|'.join(PACKAGES)})(?:\.[A-Za-z_]\w*)+")
BARE_FILE = re.compile(r"[\w/*]+\.py")
BARE_FOLDER = re.compile(r"\w[\w/]*/")
TEST = re.compile(r"(tests/[\w/]+\.py)::(\w+)")
SHORT_NAME = re.compile(r"([A-Za-z_]\w*)\.([a-z_]\w*)")
PARAMETER = re.compile(rf"(?<![\w./`-])`?({'|'.join(STAGES)})\.([a-z]\w*)\b(?:=(\w[\w-]*))?")
PLACEHOLDER = re.compile(r"\b[A-Z]{3,}\b")  # stages/NAME/
DATA_ENDINGS = {"bin", "csv", "exr", "hdr", "html", "json", "md", "npy", "npz", "ply", "png", "toml", "txt", "webp", "xml"}
DATA_ENDINGS |= {"glb", "mtl", "mtlx", "obj", "usdz"}


def data_folders() -> set[str]:
    """Folders that the documents of captures and datasets speak of: theirs, not the project's."""
    names = ("captures.md", "dataset.md", "light_stage.md")
    return {folder for n in names for folder in BARE_FOLDER.findall((ROOT / "docs" / n).read_text(encoding="utf-8"))}


@cache
def defined(path: Path) -> frozenset[str]:
    """Every name that a file defines: at its top, in a class, imported."""
    found: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        match node:
            case ast.FunctionDef(name=name) | ast.ClassDef(name=name):
                found.add(name)
            case ast.Assign(targets=targets):
                found |= {t.id for t in targets if isinstance(t, ast.Name)}
            case ast.AnnAssign(target=ast.Name(id=name)):
                found.add(name)
            case ast.Import(names=names) | ast.ImportFrom(names=names):
                found |= {alias.asname or alias.name for alias in names}
    return frozenset(found)


def is_there(path: str, document: Path) -> bool:
    """Whether a path stands for something of the project: from the root, or the end of one; `*` for anything within a name."""
    path = path.removesuffix("/__pycache__")  # made by the first import, or elsewhere
    pattern = re.compile(rf"(?:.*/)?{re.escape(path.rstrip('/.')).replace(re.escape('*'), '[^/]*')}")
    return (ROOT / path).exists() or (document.parent / path).exists() or any(pattern.fullmatch(p) for p in PLACES)


def is_defined(name: str) -> bool:
    """Whether a name from a package on is a module, or something that one defines."""
    parts = name.split(".")
    for depth in range(len(parts), 0, -1):
        folder = ROOT.joinpath(*parts[:depth])
        path = folder / "__init__.py" if folder.is_dir() else folder.with_suffix(".py")
        if path.is_file() or folder.is_dir():
            return depth == len(parts) or (path.is_file() and set(parts[depth:]) <= defined(path))
    return False


def wrong_parameter(stage: str, name: str, value: str | None) -> bool:
    """Whether a stage has no such parameter, or the parameter no such choice."""
    kinds = get_type_hints(PARAMETERS[stage])
    if name not in {f.name for f in fields(PARAMETERS[stage])}:
        return True
    choices = [c for part in (kinds[name], *get_args(kinds[name])) if get_origin(part) is Literal for c in get_args(part)]
    return bool(choices) and value is not None and not PLACEHOLDER.fullmatch(value) and value not in choices


PARAMETERS = {name: stage.parameters for name, stage in load_stages(STAGES).items()}


def missing(text: str, document: Path) -> list[str]:
    """What a document names and is not there."""
    found = [t for t in LINK.findall(text) if "://" not in t and not (document.parent / t).exists()]
    found += [t for t in ROOTED_PATH.findall(text) if not PLACEHOLDER.search(t) and not is_there(t, document)]
    found += [t for t in ROOTED_NAME.findall(text) if t.rpartition(".")[2] not in DATA_ENDINGS and not is_defined(t)]
    found += [f"{path}::{name}" for path, name in TEST.findall(text) if name not in defined(ROOT / path)]
    for stage, name, value in PARAMETER.findall(text):
        if name not in DATA_ENDINGS and wrong_parameter(stage, name, value or None):
            found.append(f"{stage}.{name}={value}" if value else f"{stage}.{name}")
    folders = data_folders()
    for token in TICKED.findall(text):
        ours = BARE_FILE.fullmatch(token) or (BARE_FOLDER.fullmatch(token) and token not in folders)
        if ours and not PLACEHOLDER.search(token):
            found += [] if is_there(token, document) else [token]
        elif (short := SHORT_NAME.fullmatch(token)) and short[1] in MODULES and short[1] not in (*STAGES, *PACKAGES):
            known = short[2] in DATA_ENDINGS or any(short[2] in defined(p) for p in MODULES[short[1]])
            found += [] if known else [token]
    return found


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda p: str(p.relative_to(ROOT)))
def test_what_a_document_names_is_there(document):
    gone = missing(document.read_text(encoding="utf-8"), document)
    assert not gone, f"mend what {document.relative_to(ROOT)} says: {sorted(set(gone))}"


@pytest.mark.parametrize(
    ("there", "gone"),
    [
        (["`trainer.py`", "`splats/`", "`stages/train/rasterize/kernel_*.py`", "[a](adding.md)"], []),
        ([], ["`exchange.py`", "`recess/`", "stages/train/recess/", "[a](absent.md)"]),
        (["`pipeline.geometry.cameras.Camera.stokes_frame`", "`from pipeline.errors import x`"], ["pipeline.lights"]),
        (["`lobe.plain`", "`run.warn`", "`capture.toml`"], ["`lobe.absent`", "`pipeline.optics.stokes.frame`"]),
        (["tests/house/test_documents.py::is_there"], ["tests/house/test_documents.py::absent"]),
        (["`train.start`", "PARAMS='train.iterations=5 olat.solver=closed'", "`olat.solver=NAME`", "`mesh.ply`"], []),
        ([], ["`train.recesses`", "olat.solver=absent"]),
    ],
)
def test_what_is_gone_is_found_and_what_is_there_is_not(there, gone):
    found = missing("; ".join([*there, *gone]), ROOT / "docs" / "stages.md")
    assert set(found) == {re.sub(r"^\[a\]\(|[`)]", "", name) for name in gone}
