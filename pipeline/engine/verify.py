"""The `verify` command: read everything in use against its digests, name what is damaged, drop it when asked."""

from __future__ import annotations

import argparse
import contextlib
import shutil
from collections.abc import Iterable
from pathlib import Path

from pipeline.engine.dataset import Dataset, description
from pipeline.engine.dataset.damage import Damage, damaged_files, damaged_records, versions_in_use
from pipeline.engine.dataset.documents import seal_fits, write_whole
from pipeline.engine.dataset.links import refuse_links
from pipeline.engine.dataset.verified import Verified
from pipeline.engine.places import existing_dataset
from pipeline.engine.progress import Progress
from pipeline.errors import UserError

MEGA = 1e6


def verify(options: argparse.Namespace, stages: Iterable[str]) -> int:
    """Run `verify`; returns 0 where all is whole (or was put right), 1 where something is damaged. Raises UserError."""
    dataset, stages = existing_dataset(options.capture, options.dataset, "verify"), list(stages)
    writable = True
    try:
        dataset.prepare()
    except UserError:
        if options.repair:
            raise
        writable = False  # a dataset on a read-only disk can be read all the same
    with dataset.in_use(alone=options.repair) if writable else contextlib.nullcontext(True) as granted:
        if not granted:
            raise UserError(dataset.root, "another run is at work on this dataset", "try again when it has ended")
        found = _search(dataset, stages, options, writable)
        for damage in found:
            print(f"damaged: {damage.file} {damage.fault}")
        if found and options.repair:
            return _repair(dataset, found)
    if found:
        print(f"{_files(len(found))} damaged; `make verify DATASET={dataset.root} REPAIR=1` drops what holds them")
    return 1 if found else 0


def _search(dataset: Dataset, stages: list[str], options: argparse.Namespace, writable: bool) -> list[Damage]:
    records = list(damaged_records(dataset, stages))
    versions, found = versions_in_use(dataset, stages)
    known = Verified(dataset.root, options.full, writable)
    total = sum(o["bytes"] for v in versions for o in v.manifest["outputs"])
    count = sum(len(v.manifest["outputs"]) + 1 for v in versions)
    try:
        with Progress(quiet=options.quiet).bar("verifying", total / MEGA, "MB") as bar:
            found += damaged_files(dataset, versions, known, lambda n: bar.advance(n / MEGA))
    finally:
        known.save()
    if not found and not records:
        what = f"{len(versions)} versions, {_files(count)}, {total / MEGA:.1f} MB"
        print(f"{dataset.root}: all that is in use is whole ({what})" if versions else f"{dataset.root}: nothing is in use yet")
    return [*records, *found]


def _repair(dataset: Dataset, found: list[Damage]) -> int:
    """Drop what is damaged; a record that has a whole copy is taken from that."""
    for drop in dict.fromkeys(damage.drop for damage in found):
        refuse_links(dataset.root, drop.parent)
        if drop == dataset.root / description.FILE and _restored(dataset.root):
            print(f"restored: {drop}")
        elif drop.is_dir() and not drop.is_symlink():
            shutil.rmtree(drop)
            print(f"dropped: {drop}")
        else:
            drop.unlink(missing_ok=True)
            print(f"dropped: {drop}")
    print("the next run makes again what was dropped, and nothing else: `make all` with the arguments of the last run")
    return 0


def _restored(root: Path) -> bool:
    copy = description.kept_copy(root)
    if seal_fits(copy):
        write_whole(root / description.FILE, copy.read_text())
        return True
    return False


def _files(n: int) -> str:
    return f"{n} file{'s' * (n != 1)}"
