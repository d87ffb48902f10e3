"""Which capture and which dataset a call means, and whether the two belong together."""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from pipeline.capture import Capture, open_capture
from pipeline.capture.naming.safe_names import refuse_unsafe_names
from pipeline.engine.dataset import Dataset
from pipeline.engine.plan import Step
from pipeline.errors import UserError


def open_places(capture: str, dataset: str, command: str) -> tuple[Capture, Dataset]:
    """The capture and the dataset; either tells the other where one is not given. Raises UserError."""
    if not capture and not dataset:
        raise UserError("CAPTURE", "no capture folder was given", f"as in `make {command} CAPTURE=folder`")
    source = Path(capture) if capture else _recorded_capture(Path(dataset))
    root = Path(dataset) if dataset else Path("datasets") / source.absolute().name
    _refuse_a_dataset_as_capture(source)
    _refuse_a_capture_as_dataset(source, root)
    opened = open_capture(source)
    refuse_unsafe_names(opened)
    return opened, Dataset(root)


def existing_dataset(capture: str, dataset: str, command: str = "gc") -> Dataset:
    """The dataset of a call that reads no capture. Raises UserError where there is none."""
    if not capture and not dataset:
        call = f"make {command} DATASET=folder" if command in ("gc", "verify") else f"polarfield {command} --dataset=folder"
        raise UserError("DATASET", "no dataset was given", f"as in `{call}`")
    if not dataset:
        _refuse_a_dataset_as_capture(Path(capture))
    found = Dataset(Path(dataset) if dataset else Path("datasets") / Path(capture).absolute().name)
    if not found.exists:
        fault = "is not a dataset (it has no dataset.json)" if found.root.is_dir() else "no such dataset"
        raise UserError(found.root, fault, "check DATASET=")
    return found


def _recorded_capture(dataset: Path) -> Path:
    recorded = Dataset(dataset).read_description().get("capture")
    if not recorded:
        if _looks_like_a_capture(dataset):
            raise UserError(dataset, "is a capture, not a dataset", f"give it as CAPTURE={dataset}")
        fault = "is not a dataset (it has no dataset.json that tells its capture)" if dataset.is_dir() else "no such dataset"
        raise UserError(dataset, fault, "check DATASET=, or give CAPTURE= too")
    source = Path(os.path.normpath(dataset.absolute() / recorded))
    if not source.is_dir():
        raise UserError(dataset, f"the capture that it was made from is not at {source} any more", "give CAPTURE= as well")
    return source


def _refuse_a_dataset_as_capture(folder: Path) -> None:
    if not Dataset(folder).read_description().get("plan"):
        return
    recorded = Dataset(folder).read_description().get("capture")
    source = os.path.normpath(folder.absolute() / recorded) if recorded else "folder"
    remedy = f"give DATASET={folder}, and as CAPTURE= what it was made from: {source}"
    raise UserError(folder, "is a dataset, not a capture", remedy)


def _refuse_a_capture_as_dataset(capture: Path, dataset: Path) -> None:
    """A capture is never written to, be it this one or another."""
    inner, outer = Path(os.path.realpath(dataset)), Path(os.path.realpath(capture))
    if inner == outer:
        raise UserError(dataset, "is the capture itself, which is never written to", "give DATASET= another folder")
    if inner.is_relative_to(outer):
        raise UserError(dataset, "lies inside the capture, which is never written to", "give DATASET= a folder outside of it")
    if not Dataset(dataset).exists and _looks_like_a_capture(dataset):
        raise UserError(dataset, "is a capture, not a dataset", "give DATASET= a new folder")


def _looks_like_a_capture(folder: Path) -> bool:
    try:
        return folder.is_dir() and any(folder.iterdir()) and bool(open_capture(folder))
    except (UserError, OSError):
        return False


def refuse_another_capture(dataset: Dataset, capture: Capture, steps: Sequence[Step]) -> None:
    """Raise UserError where the dataset was made from another capture.

    The same folder is the same capture, whatever was changed in it. A folder elsewhere is the same when at least half
    of the files that stages read are the same by content: it was moved, copied or renamed, and perhaps mended.
    """
    recorded = dataset.read_description().get("capture")
    if not recorded:
        return
    source = os.path.realpath(dataset.root.absolute() / recorded)
    if source == os.path.realpath(capture.root):
        return
    telling = [step for step in steps if not step.stage.environments]  # maps may be those of any capture
    before = _digests(v.manifest.get("inputs", {}) for v in map(dataset.current, [s.stage.name for s in telling]) if v)
    now = _digests(step.inputs for step in telling)
    if before and 2 * len(before & now) < min(len(before), len(now)):
        fault = f"was made from another capture, {os.path.normpath(source)}, not from {capture.root}"
        raise UserError(dataset.root, fault, "choose another DATASET=, or remove this one first")


def _digests(inputs: Iterable[Any]) -> set[str]:
    """Digests of the capture's files that a set of stages reads."""
    return {digest for i in inputs for digest in i.get("files", {}).values()}
