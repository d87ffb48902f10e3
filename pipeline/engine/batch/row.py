"""One capture of a batch: its plan, what is left of it, and what came of it."""

from __future__ import annotations

import argparse
import contextlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from pipeline.engine.batch.captures import Place
from pipeline.engine.call import Call, describe, open_call
from pipeline.engine.changes import State, states
from pipeline.engine.dataset import Dataset, DigestCache
from pipeline.engine.places import refuse_another_capture
from pipeline.engine.plan import Step, make_plan
from pipeline.engine.program import Program
from pipeline.engine.settings import remember
from pipeline.engine.stage import Stage
from pipeline.errors import UserError, line_of, one_line


@dataclass
class Row:
    """One capture of a batch.

    `left`: the steps to make, in running order. `made`: names of those that this batch made. `fault`: the line that
    stopped it, and `at` the stage in which it did (empty: the capture could not be read).
    """

    place: Place
    root: Path
    call: Call | None = None
    steps: list[Step] = field(default_factory=list)
    found: Mapping[str, State] = field(default_factory=dict)
    left: list[Step] = field(default_factory=list)
    made: list[str] = field(default_factory=list)
    fault: str = ""
    at: str = ""
    begun: bool = False
    held: contextlib.ExitStack = field(default_factory=contextlib.ExitStack)

    @property
    def dataset(self) -> Dataset:
        """Where its results lie."""
        return self.call.dataset if self.call is not None else Dataset(self.root)

    @property
    def done(self) -> bool:
        """Nothing is left to do, and nothing went wrong."""
        return not self.fault and not self.left

    def memory_mb(self, step: Step) -> float:
        """MiB that a step will have at its peak."""
        assert self.call is not None
        return step.stage.memory(self.call.capture, step.parameters, 1)

    def begin(self) -> None:
        """Open the dataset for writing, before its first stage starts. Raises UserError."""
        assert self.call is not None
        dataset = self.call.dataset
        dataset.prepare()
        self.held.enter_context(dataset.in_use())
        self.begun = True
        dataset.digests.save(dataset.write_text)
        for step in self.steps:
            if self.found[step.stage.name].kind == "switch":
                self.use(step)
        self._describe()

    def use(self, step: Step) -> bool:
        """Put the version of a step to use; returns whether it is there."""
        version = self.dataset.find(step.stage.name, step.key)
        if version is not None:
            self.dataset.use(version)
        return version is not None

    def end(self) -> None:
        """Tell the dataset what it is now, and let go of it."""
        with self.held:
            self._describe()

    def _describe(self) -> None:
        assert self.call is not None
        ran = {step.stage.name for step in self.steps if step.decision.run}
        describe(self.call, self.steps, remember(self.call.last, self.call.settings, ran, self.call.stages))


def row_of(
    place: Place, root: Path, program: Program, options: argparse.Namespace, stages: Mapping[str, Stage], maps: DigestCache
) -> Row:
    """Plan one capture of a batch; what is wrong with it is its row's fault, not the batch's.

    `maps`: digests of files that all share.
    """
    row = Row(place, root)
    one = argparse.Namespace(**{**vars(options), "command": "all", "capture": str(place.capture), "dataset": str(root)})
    try:
        row.call = call = open_call(program, one, stages)
        call.dataset.digests.take(maps)
        row.steps = make_plan(call.capture, stages, call.settings.parameters, call.capture.environments, call.dataset.digests)
        refuse_another_capture(call.dataset, call.capture, row.steps)
        row.found = states(call.dataset, row.steps)
        row.left = [step for step in row.steps if not row.found[step.stage.name].ready]
        for step in row.left:
            step.stage.check(call.capture)
    except (UserError, OSError, MemoryError) as error:
        row.fault, row.left = line_of(error), []
    except Exception as error:  # a fault of the program with one capture stops none of the others
        row.fault, row.left = f"{type(error).__name__}: {one_line(str(error))} (a fault of the program)", []
    return row
