"""dataset.json: what a dataset was made from and with; whatever the file holds, what is read of it has its type."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pipeline.engine.dataset.documents import read_object, sealed, write_whole

FILE = "dataset.json"
SCHEMA = 1


def read_description(root: Path) -> dict[str, Any]:
    """What dataset.json tells (`capture`, `layout`, `fingerprint`, `plan`, `given`); parts of another type are left out."""
    table = read_object(root / FILE) or {}
    out = {k: v for k, v in table.items() if k not in ("capture", "plan", "given")}
    if isinstance(table.get("capture"), str) and "\0" not in table["capture"]:
        out["capture"] = table["capture"]
    if isinstance(table.get("plan"), dict):
        out["plan"] = {k: v for k, v in table["plan"].items() if _is_decision(v)}
    given = table.get("given")
    if isinstance(given, dict):
        parameters, environments = given.get("parameters"), given.get("environments")
        out["given"] = {
            "parameters": {s: v for s, v in parameters.items() if isinstance(v, dict)} if isinstance(parameters, dict) else {},
            "environments": [p for p in environments if isinstance(p, str)] if isinstance(environments, list) else [],
        }
    return out


def write_description(root: Path, description: Mapping[str, Any]) -> None:
    """Write dataset.json, sealed, and beside the unfinished work a copy that a damaged one is mended from."""
    text = sealed({"schema": SCHEMA, **description})
    for path in (root / FILE, kept_copy(root)):
        write_whole(path, text)


def kept_copy(root: Path) -> Path:
    """The copy of dataset.json."""
    return root / ".work" / FILE


def _is_decision(value: Any) -> bool:
    return isinstance(value, dict) and isinstance(value.get("run"), bool) and isinstance(value.get("reason"), str)
