"""The `gc` command: list what can go and how much that is, ask a person, remove."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterable

from pipeline.engine.dataset import Dataset
from pipeline.engine.dataset.garbage import Garbage, garbage, remove
from pipeline.engine.places import existing_dataset
from pipeline.errors import UserError

MEGA = 1e6


def collect(options: argparse.Namespace, stages: Iterable[str]) -> int:
    """Run `gc`; returns the exit status. Raises UserError where there is no dataset, or a run is at work on it."""
    dataset = existing_dataset(options.capture, options.dataset)
    if options.dry_run:
        _list(dataset, garbage(dataset, stages), "would remove")
        return 0
    dataset.prepare()
    with dataset.in_use(alone=True) as granted:
        if not granted:
            raise UserError(dataset.root, "another run is at work on this dataset", "try again when it has ended")
        items = garbage(dataset, stages)
        asked = bool(items) and not options.yes and sys.stdin.isatty() and sys.stdout.isatty()
        _list(dataset, items, "can go:" if asked else "removing")
        if asked and input("remove these? [y/N] ").strip().lower() not in ("y", "yes"):
            print("nothing was removed")
            return 0
        remove(items)
    return 0


def _list(dataset: Dataset, items: list[Garbage], verb: str) -> None:
    for item in items:
        print(f"{verb} {item.folder} ({item.what}, {item.bytes / MEGA:.1f} MB)")
    total = sum(item.bytes for item in items) / MEGA
    if items:
        print(f"{len(items)} folder{'s' * (len(items) != 1)}, {total:.1f} MB; what results in use were made from stays")
    else:
        print(f"{dataset.root}: nothing to remove")
