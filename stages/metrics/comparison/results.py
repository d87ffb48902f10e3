"""What is compared: the results of datasets, or of single versions of them."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from pipeline.engine.dataset import Dataset
from pipeline.errors import UserError

REMEDY = "give a dataset that `make all` finished, or DATASET/metrics/VERSION"


@dataclass(frozen=True)
class Result:
    """One column: a name, metrics.json, and the manifests and folders of the versions that it was made from."""

    name: str
    metrics: dict[str, Any]
    manifests: dict[str, dict[str, Any]] = field(default_factory=dict)
    folders: dict[str, Path] = field(default_factory=dict)


def read_results(paths: Sequence[Path]) -> list[Result]:
    """The results at these paths, with names that differ. Raises UserError, naming the first path that holds none."""
    found = [_read(path) for path in paths]
    names = [result.name for result in found]
    shared = len(set(names)) < len(names)
    return [Result(str(path), *_rest(r)) if shared else r for path, r in zip(paths, found)]


def _rest(result: Result) -> tuple[dict[str, Any], dict[str, dict[str, Any]], dict[str, Path]]:
    return result.metrics, result.manifests, result.folders


def _read(path: Path) -> Result:
    """A dataset's version in use, or the version of metrics that `path` is."""
    if (path / "manifest.json").is_file():
        dataset, key = Dataset.holding(path.resolve()), path.resolve().name
        version = dataset.read("metrics", key)
        name = f"{dataset.root.name} {key[:8]}"
    else:
        dataset = Dataset(path)
        if not dataset.exists:
            raise UserError(path, "is no dataset", REMEDY)
        version, name = dataset.current("metrics"), path.resolve().name
    if version is None:
        raise UserError(path, "has no results to compare", REMEDY)
    place = dataset.place(version)
    try:
        metrics = json.loads((place / "metrics.json").read_text())
    except (OSError, ValueError) as error:
        raise UserError(place / "metrics.json", f"cannot be read ({error})", f"`make verify DATASET={dataset.root}`") from error
    manifests, folders = {"metrics": dict(version.manifest)}, {"metrics": place}
    for stage, upstream in version.manifest.get("inputs", {}).get("stages", {}).items():
        made = dataset.read(stage, upstream)
        if made is not None:
            manifests[stage], folders[stage] = dict(made.manifest), dataset.place(made)
    return Result(name, metrics, manifests, folders)
