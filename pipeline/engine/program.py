"""What a command line runs: stages by name, and what is done with their results."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from pipeline.capture import Capture
from pipeline.engine.changes import State
from pipeline.engine.dataset import Dataset
from pipeline.engine.early import Look
from pipeline.engine.plan import Step

Inspect = Callable[[Capture, Sequence[Step], Path, Mapping[str, State]], Path]
"""Write what was understood of a capture to a folder, with a plan and how its steps stand; returns the page's path."""

Compare = Callable[[Sequence[Path], Path], Path]
"""Write a page that shows results side by side into a folder; returns its path."""

Tradeoff = Callable[[Path, Path, str, str, Callable[[str], None]], Path]
"""Try a capture (first) with other parameters beside its dataset, given PARAMS and ENVS; returns the page's path."""

Export = Callable[[Dataset, str, str], Path]
"""Copy results of a dataset in a format to a folder ("": one beside it); returns the folder."""


@dataclass(frozen=True)
class Program:
    """What a command line runs; the engine itself knows no stage.

    Fields:
        modules: each stage's module by its name, in running order.
        module: `python -m MODULE STAGE ...` runs one stage in a process of its own.
        report: the stage whose output the report is.
        inspect: writes the page of `inspect`.
        compare: writes the page of `compare`.
        tradeoff: tries out other parameters.
        look: finds what a run would warn of.
        export: copies results.
        formats: that `export` can write.
    """

    modules: Mapping[str, str]
    module: str
    report: str
    inspect: Inspect
    compare: Compare | None = None
    tradeoff: Tradeoff | None = None
    look: Look | None = None
    export: Export | None = None
    formats: tuple[str, ...] = ()
