"""The `gc` command: list what can go and how much that is, ask a person, remove."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterable

from pipeline.engine.dataset import Dataset
from pipeline.engine.dataset.garbage import Collection, collection, remove
from pipeline.engine.places import existing_dataset
from pipeline.errors import UserError

MEGA = 1e6


def collect(options: argparse.Namespace, stages: Iterable[str]) -> int:
    """Run `gc`; returns the exit status. Raises UserError where there is no dataset, or a run is at work on it."""
    dataset = existing_dataset(options.capture, options.dataset)
    if options.dry_run:
        _list(dataset, collection(dataset, stages), "would remove")
        return 0
    dataset.prepare()
    with dataset.in_use(alone=True) as granted:
        if not granted:
            raise UserError(dataset.root, "another run is at work on this dataset", "try again when it has ended")
        found = collection(dataset, stages)
        _list(dataset, found, "removing" if options.yes else "can go:")
        if found.items and (options.yes or _agreed(dataset)):
            remove(found.items)
    return 0


def _agreed(dataset: Dataset) -> bool:
    """Whether a person says yes; where none can be asked, how to say it in advance."""
    if not (sys.stdin.isatty() and sys.stdout.isatty()):
        print(f"nothing was removed: `make gc DATASET={dataset.root} YES=1` (--yes) removes these without asking")
        return False
    if input("remove these? [y/N] ").strip().lower() in ("y", "yes"):
        return True
    print("nothing was removed")
    return False


def _list(dataset: Dataset, found: Collection, verb: str) -> None:
    for item in found.items:
        print(f"{verb} {item.folder} ({item.what}, {item.bytes / MEGA:.1f} MB)")
    for doubt in found.doubts:
        print(f"kept: {doubt}")
    total = sum(item.bytes for item in found.items) / MEGA
    if found.items:
        count = len(found.items)
        print(f"{count} folder{'s' * (count != 1)}, {total:.1f} MB; what results in use were made from stays")
    else:
        print(f"{dataset.root}: nothing to remove")
