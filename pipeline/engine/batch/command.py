"""The `batch` command: plan over many captures, make what is left of all of them, write one table."""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from pipeline.engine.batch import plan_file
from pipeline.engine.batch.captures import places_of
from pipeline.engine.batch.row import Row, row_of
from pipeline.engine.batch.side_by_side import SideBySide
from pipeline.engine.batch.slurm import ROUNDS, submit
from pipeline.engine.batch.snakemake import run_snakemake
from pipeline.engine.batch.table import write_table
from pipeline.engine.dataset import DigestCache
from pipeline.engine.dataset.documents import write_whole
from pipeline.engine.dataset.links import refuse_links
from pipeline.engine.device import refuse_missing_cuda
from pipeline.engine.memory import machine_mb, parsed_mb
from pipeline.engine.program import Program
from pipeline.engine.progress import Progress
from pipeline.engine.settings import given_settings
from pipeline.engine.stage import Stage
from pipeline.errors import UserError

OWN = ".batch"  # what a batch keeps beside the datasets: logs, the plan, digests of shared maps


def batch(program: Program, options: argparse.Namespace, stages: Mapping[str, Stage], arguments: Sequence[str]) -> int:
    """Run `batch`; returns 0 where every capture is done (or is submitted), 1 where one is not. Raises UserError."""
    started = time.monotonic()
    folder = Path(options.dataset or "datasets")
    own = folder / OWN

    def plan() -> list[Row]:
        return planned(program, options, stages, folder)

    rows = plan()
    _announce(rows)
    if options.dry_run:
        return _tell_undone(rows)
    _refuse_what_cannot_be(options, rows)
    if options.slurm:
        _leave_out_refused(rows, own, options)
    try:
        if options.snakemake is not None:
            rows = _by_snakemake(rows, plan, own, options)
        elif not options.slurm:
            SideBySide(rows, options.jobs, _memory_mb(options), own / "logs", Progress(quiet=options.quiet)).run()
        _put_to_use(rows)
    finally:
        page = write_table(rows, folder, program.report, time.monotonic() - started)
    print(f"{sum(row.done for row in rows)} of {len(rows)} captures are done; the table: {page}")
    if options.slurm and _submit(rows, own, options, arguments):
        return 0
    return _tell_undone(rows)


def planned(program: Program, options: argparse.Namespace, stages: Mapping[str, Stage], folder: Path) -> list[Row]:
    """Every capture of a call with its plan. Raises UserError where options are wrong, or there are no captures."""
    if not options.capture:
        raise UserError("CAPTURES", "no folder of captures was given", "as in `make batch CAPTURES=folder`")
    places = places_of(Path(options.capture))
    for place in places:
        if folder.absolute().is_relative_to(place.capture.absolute()):
            raise UserError(folder, f"lies inside the capture {place.capture}", "give DATASET= a folder outside of it")
    maps = given_settings(options.params, options.envs, {}, "all", stages).environments
    folder.mkdir(parents=True, exist_ok=True)
    refuse_links(folder, folder / OWN)
    shared = DigestCache(folder / OWN / "digests.json")
    shared.digests(folder, [path for path in maps if path.is_file()])
    rows = [row_of(place, folder / place.name, program, options, stages, shared) for place in places]
    shared.save(write_whole)
    return rows


def _refuse_what_cannot_be(options: argparse.Namespace, rows: Sequence[Row]) -> None:
    elsewhere = options.slurm or options.snakemake is not None
    if options.slurm and options.snakemake is not None:
        raise UserError("--slurm", "an array and Snakemake are two ways", "give one, as in --snakemake='--executor slurm'")
    if options.cores < 1:
        raise UserError("--cores", f"{options.cores} is not a whole number from 1 on", "as in 4")
    if options.device == "cuda" and not elsewhere and any(step.stage.device for row in rows for step in row.left):
        refuse_missing_cuda()


def _memory_mb(options: argparse.Namespace) -> float:
    return parsed_mb(options.memory) if options.memory else machine_mb()


def _by_snakemake(rows: list[Row], plan: Callable[[], list[Row]], own: Path, options: argparse.Namespace) -> list[Row]:
    """Run what is left on Snakemake; returns the rows as they are after it."""
    left = [row for row in rows if row.left]
    if not left:
        return rows
    plan_id = f"{time.time_ns():x}"
    path = plan_file.write_plan(left, own, options.cores, plan_id)
    status = run_snakemake(path, options.snakemake, options.jobs, options.cores, _memory_mb(options))
    after = plan()
    if status and not (own / "made").is_dir() and (said := (own / "snakemake.log").read_text(errors="replace").split("\n")):
        raise UserError("--snakemake", next((line for line in reversed(said) if line.strip()), "it failed"), "mend it")
    before = {row.place.name: {step.stage.name for step in row.left} for row in rows}
    for row in after:
        row.made = [s.stage.name for s in row.steps if s.stage.name in before[row.place.name] and s not in row.left]
    plan_file.tell_faults(after, own, plan_id)
    return after


def _leave_out_refused(rows: list[Row], own: Path, options: argparse.Namespace) -> None:
    """In a later round: what was refused in an earlier one is not tried again."""
    if options.round > 1:
        plan_file.tell_faults(rows, own, plan_file.read_plan(own / "plan.json")["id"])


def _submit(rows: list[Row], own: Path, options: argparse.Namespace, arguments: Sequence[str]) -> bool:
    """Submit an array of what is left; returns whether there was any, and a round for it."""
    plan_id = plan_file.read_plan(own / "plan.json")["id"] if options.round > 1 else f"{time.time_ns():x}"
    left = [row for row in rows if row.left]
    if left and options.round <= ROUNDS:
        path = plan_file.write_plan(left, own, options.cores, plan_id)
        again = list(arguments[: arguments.index("--round")] if "--round" in arguments else arguments)
        number = submit(path, again, options.sbatch, options.jobs, options.round)
        print(f"submitted: array {number} of {len(left)} captures; the table is written when it has ended")
        return True
    return False


def _put_to_use(rows: Sequence[Row]) -> None:
    """Captures of which every version is there, but not all are in use."""
    for row in rows:
        if row.done and not row.begun and any(state.kind == "switch" for state in row.found.values()):
            with row.held:
                row.begin()


def _announce(rows: Sequence[Row]) -> None:
    left = [row for row in rows if row.left]
    count = sum(len(row.left) for row in left)
    done = sum(row.done for row in rows)
    print(f"{len(rows)} captures: {done} done, {len(left)} to do ({count} stages), {sum(bool(r.fault) for r in rows)} refused")


def _tell_undone(rows: Sequence[Row]) -> int:
    """Name the captures that are not done, and why; returns the exit status."""
    undone = [row for row in rows if not row.done]
    for row in undone:
        print(f"{row.place.name}: {row.fault or 'to do: ' + ', '.join(step.stage.name for step in row.left)}")
    return 1 if undone else 0
