"""The `batch` command: plan over many captures, make what is left of all of them, write one table."""

from __future__ import annotations

import argparse
import time
from collections.abc import Mapping, Sequence
from pathlib import Path

from pipeline.engine.batch.captures import places_of
from pipeline.engine.batch.row import Row, row_of
from pipeline.engine.batch.side_by_side import SideBySide
from pipeline.engine.batch.table import write_table
from pipeline.engine.call import Program
from pipeline.engine.dataset import DigestCache
from pipeline.engine.dataset.documents import write_whole
from pipeline.engine.dataset.links import refuse_links
from pipeline.engine.device import refuse_missing_cuda
from pipeline.engine.memory import machine_mb, parsed_mb
from pipeline.engine.progress import Progress
from pipeline.engine.settings import given_settings
from pipeline.engine.stage import Stage
from pipeline.errors import UserError

OWN = ".batch"  # what a batch keeps beside the datasets: logs, digests of shared maps


def batch(program: Program, options: argparse.Namespace, stages: Mapping[str, Stage]) -> int:
    """Run `batch`; returns 0 where every capture is done, 1 where one is not. Raises UserError."""
    started = time.monotonic()
    folder = Path(options.dataset or "datasets")
    rows = planned(program, options, stages, folder)
    _announce(rows)
    if options.dry_run:
        return _tell_undone(rows)
    if options.device == "cuda" and any(step.stage.device for row in rows for step in row.left):
        refuse_missing_cuda()
    memory_mb = parsed_mb(options.memory) if options.memory else machine_mb()
    progress = Progress(quiet=options.quiet)
    try:
        SideBySide(rows, options.jobs, memory_mb, folder / OWN / "logs", progress).run()
    finally:
        page = write_table(rows, folder, program.report, time.monotonic() - started)
    print(f"{sum(row.done for row in rows)} of {len(rows)} captures are done; the table: {page}")
    return _tell_undone(rows)


def _tell_undone(rows: Sequence[Row]) -> int:
    """Name the captures that are not done, and why; returns the exit status."""
    undone = [row for row in rows if not row.done]
    for row in undone:
        print(f"{row.place.name}: {row.fault or 'to do: ' + ', '.join(step.stage.name for step in row.left)}")
    return 1 if undone else 0


def planned(program: Program, options: argparse.Namespace, stages: Mapping[str, Stage], folder: Path) -> list[Row]:
    """Every capture of a call with its plan. Raises UserError where options are wrong, or there are no captures."""
    if not options.capture:
        raise UserError("CAPTURES", "no folder of captures was given", "as in `make batch CAPTURES=folder`")
    source = Path(options.capture)
    places = places_of(source)
    inside = Path(folder).absolute()
    for place in places:
        if inside.is_relative_to(place.capture.absolute()):
            raise UserError(folder, f"lies inside the capture {place.capture}", "give DATASET= a folder outside of it")
    maps = given_settings(options.params, options.envs, {}, "all", stages).environments
    folder.mkdir(parents=True, exist_ok=True)
    refuse_links(folder, folder / OWN)
    shared = DigestCache(folder / OWN / "digests.json")
    shared.digests(folder, [path for path in maps if path.is_file()])
    rows = [row_of(place, folder / place.name, program, options, stages, shared) for place in places]
    shared.save(write_whole)
    return rows


def _announce(rows: Sequence[Row]) -> None:
    left = [row for row in rows if row.left]
    count = sum(len(row.left) for row in left)
    done = sum(row.done for row in rows)
    print(f"{len(rows)} captures: {done} done, {len(left)} to do ({count} stages), {sum(bool(r.fault) for r in rows)} refused")
