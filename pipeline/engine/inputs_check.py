"""Is what a stage reads of the dataset whole? Asked before it runs of small tables, and of every byte after it failed."""

from __future__ import annotations

import shutil
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from pipeline.capture.naming.safe_names import fault_of_name
from pipeline.engine.dataset import Dataset, Version
from pipeline.engine.dataset.damage import damaged_files
from pipeline.engine.dataset.documents import read_object
from pipeline.errors import UserError

TABLES = {"frames.json": "views", "olat.json": "cameras"}
"""Tables whose keys become names of files that later stages write."""
LEAST_FREE = 1 << 20  # bytes; a disk with less is full


def verify_remedy(dataset: Dataset) -> str:
    """What to do about a damaged result."""
    return f"`make verify DATASET={dataset.root} REPAIR=1` drops what is damaged, and the same command then makes it again"


def published(dataset: Dataset, stage: str, key: str) -> Version:
    """An upstream version. Raises UserError: it is damaged, or was planned from other inputs than it was made from."""
    version = dataset.find(stage, key)
    if version is None and (dataset.root / stage / key).exists():
        raise UserError(dataset.root / stage / key, "this version is damaged", verify_remedy(dataset))
    if version is None:
        raise UserError(stage, "the capture or the program was changed during the run", "the same command goes on from here")
    return version


def refuse_unsafe_tables(dataset: Dataset, versions: Iterable[Version]) -> None:
    """Raise UserError where a table of a version, which anyone may have written, names views that no file can be called."""
    for version in versions:
        for name, key in TABLES.items():
            path = version.folder / name
            if not path.exists():
                continue
            names = (read_object(path) or {}).get(key)
            if not isinstance(names, dict):
                raise UserError(path, f"has no table of {key}: it is damaged", verify_remedy(dataset))
            for view in names:
                if fault := fault_of_name(view):
                    raise UserError(path, f"the name {view[:40]!r} {fault}: it is damaged", verify_remedy(dataset))
        _refuse_unsafe_cameras(dataset, version.folder / "cameras.json")


def _refuse_unsafe_cameras(dataset: Dataset, path: Path) -> None:
    from pipeline.geometry.cameras import load_cameras

    if not path.exists():
        return
    try:
        names = list(load_cameras(path))
    except (UserError, LookupError, TypeError, ValueError, AttributeError):
        raise UserError(path, "cannot be read as cameras: it is damaged", verify_remedy(dataset)) from None
    for view in names:
        if fault := fault_of_name(view):
            raise UserError(path, f"the name {view[:40]!r} {fault}: it is damaged", verify_remedy(dataset))


def cause(error: Exception, dataset: Dataset, inputs: Mapping[str, Version]) -> Exception:
    """Why a stage failed: a full disk or a damaged input where it is one of these, else the error itself."""
    if isinstance(error, UserError) and not _below(error.file, dataset.root):
        return error
    if shutil.disk_usage(dataset.root).free < LEAST_FREE:
        return UserError(dataset.root, "no space left on the target", "free some space or choose another DATASET=")
    damage: Any = next(damaged_files(dataset, inputs.values(), None), None)
    if damage is None:
        return error
    return UserError(damage.file, f"{damage.fault}: it is damaged", verify_remedy(dataset))


def _below(file: str, root: Path) -> bool:
    return Path(file).absolute().is_relative_to(root.absolute())
