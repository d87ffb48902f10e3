"""One published version of a stage's output, and its manifest, which anyone may have written."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any

from pipeline.engine.dataset.digests import digest_json
from pipeline.engine.dataset.documents import read_object
from pipeline.formats.dataset_files import MANIFEST

KEY = re.compile(r"[0-9a-f]{16}")


@dataclass(frozen=True)
class Version:
    """One published version: its stage, its key, where it lies, and the manifest that was published with it."""

    stage: str
    key: str
    folder: Path
    manifest: Mapping[str, Any]

    @property
    def made_from(self) -> dict[str, str]:
        """The key of each upstream stage's version that it read."""
        return dict(self.manifest["inputs"].get("stages", {}))


def read_version(stage: str, key: str, folder: Path) -> Version | None:
    """The version in a folder, or None where its manifest is missing, of another shape, or of another version."""
    manifest = read_object(folder / MANIFEST)
    if manifest is None or not _is_manifest(manifest) or (manifest["stage"], manifest["key"]) != (stage, key):
        return None
    return Version(stage, key, folder, manifest)


def is_whole(version: Version) -> bool:
    """Whether every file of its manifest is there in its size."""
    try:
        return all((version.folder / o["path"]).stat().st_size == o["bytes"] for o in version.manifest["outputs"])
    except (OSError, ValueError):
        return False


def content_key(content: Mapping[str, Any]) -> str:
    """The key of what a version is made of: its `stage`, `version`, `parameters` and `inputs`."""
    return digest_json({name: content.get(name) for name in ("stage", "version", "parameters", "inputs")})[:16]


def _is_manifest(m: Mapping[str, Any]) -> bool:
    """Whether all that is read of a manifest has its type, and no path of it leads out of the version."""
    texts = all(isinstance(m.get(k), str) for k in ("stage", "key"))
    tables = all(isinstance(m.get(k, {}), dict) for k in ("parameters", "inputs", "facts", "packages", "decision"))
    lists = all(isinstance(m.get(k, []), list) for k in ("outputs", "warnings"))
    if not (texts and tables and lists and "outputs" in m and "inputs" in m):
        return False
    inputs, facts = m["inputs"], m["inputs"].get("capture", {})
    if not all(_is_text_table(inputs.get(k, {})) for k in ("files", "stages")) or not isinstance(facts, dict):
        return False
    return isinstance(facts.get("views", []), list) and all(map(_is_output, m["outputs"]))


def _is_text_table(value: Any) -> bool:
    return isinstance(value, dict) and all(isinstance(v, str) for v in value.values())


def _is_output(o: Any) -> bool:
    if not isinstance(o, dict) or not isinstance(o.get("path"), str) or type(o.get("bytes")) is not int:
        return False
    path = PurePosixPath(o["path"])
    return not path.is_absolute() and ".." not in path.parts and "\0" not in o["path"] and isinstance(o.get("digest"), str)
