"""Is what a stage reads of the dataset whole? Asked before it runs of small tables, and of every byte after it failed."""

from __future__ import annotations

import contextlib
import shutil
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

from pipeline.capture.naming.safe_names import fault_of_name
from pipeline.engine.dataset import Dataset, Version
from pipeline.engine.dataset.damage import damaged_files, versions_in_use
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
    from pipeline.formats.result_check import FORMS, fault_of_table

    for version in versions:
        for path in (version.folder / o["path"] for o in version.manifest["outputs"]):
            if path.name in FORMS and (fault := fault_of_table(path)):
                raise _forged(path, fault, version)
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
    """Why a stage failed: a full disk, or a damaged or forged input where it is one of these, else the error itself."""
    if isinstance(error, UserError) and not _below(error.file, dataset.root):
        return error
    if shutil.disk_usage(dataset.root).free < LEAST_FREE:
        return UserError(dataset.root, "no space left on the target", "free some space or choose another DATASET=")
    damage: Any = next(damaged_files(dataset, inputs.values(), None), None)
    if damage is not None:
        return UserError(damage.file, f"{damage.fault}: it is damaged", verify_remedy(dataset))
    if isinstance(error, UserError | OSError | MemoryError):
        return error
    return _forged_input(inputs.values(), error) or error


def _forged_input(versions: Iterable[Version], error: Exception) -> UserError | None:
    """The first file of what failed that no stage leaves, whatever its manifest says."""
    from pipeline.formats.result_check import fault_of_result, sizes_of

    of_each = [(version, [version.folder / o["path"] for o in version.manifest["outputs"]]) for version in versions]
    sizes = sizes_of(path for _, paths in of_each for path in paths)
    for version, paths in of_each:
        for path in paths:
            if fault := fault_of_result(path, sizes):
                return _forged(path, f"{fault} ({type(error).__name__})", version)
    return None


def _forged(path: Path, fault: str, version: Version) -> UserError:
    return UserError(path, f"{fault}: no stage wrote that", f"remove {version.folder}, and the same command makes it again")


@contextlib.contextmanager
def explained(dataset: Dataset, stages: Iterable[str]) -> Iterator[None]:
    """Within it, what fails because of a damaged or forged file of a version in use is a UserError that names the file."""
    try:
        yield
    except Exception as error:
        file = error.file if isinstance(error, UserError) else error.filename if isinstance(error, OSError) else None
        if not dataset.exists or (file is not None and not _below(str(file), dataset.root)):
            raise
        versions, damaged = versions_in_use(dataset, stages)
        if damaged:
            raise UserError(damaged[0].file, f"{damaged[0].fault}: it is damaged", verify_remedy(dataset)) from error
        found = cause(error, dataset, {version.stage: version for version in versions})
        if found is error:
            raise
        raise found from error


def _below(file: str, root: Path) -> bool:
    return Path(file).absolute().is_relative_to(root.absolute())
