"""What a stage is: a name, parameters, a decision whether a scene needs it, and a run that fills one folder."""

from __future__ import annotations

import dataclasses
import typing
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pipeline.engine.costs.cost import Cost
from pipeline.engine.progress import Progress
from pipeline.errors import UserError, nearest
from pipeline.formats.dataset_files import OLAT
from pipeline.formats.typed_values import typed

if TYPE_CHECKING:
    from pipeline.capture import Capture


@dataclass(frozen=True)
class Decision:
    """Whether a stage (or a pass inside one) runs on a scene.

    Fields:
        run: whether.
        reason: in words.
        passes: of the stage, by name.
    """

    run: bool
    reason: str
    passes: Mapping[str, Decision] = field(default_factory=dict)

    def as_json(self) -> dict[str, Any]:
        """The form kept in `dataset.json`."""
        out: dict[str, Any] = {"run": self.run, "reason": self.reason}
        if self.passes:
            out["passes"] = {name: decision.as_json() for name, decision in self.passes.items()}
        return out


def no_files(capture: Capture) -> Iterable[Path]:
    """For a stage that reads nothing of the capture itself."""
    return ()


def no_given_files(capture: Capture, parameters: Any) -> Iterable[Path]:
    """For a stage whose parameters name no file."""
    return ()


def little_memory(capture: Capture, parameters: Any, jobs: int) -> float:
    """For a stage that holds next to nothing: MiB of the program itself."""
    return 150.0


def no_costs(capture: Capture, parameters: Any) -> Mapping[str, Cost]:
    """For a stage of which nothing is estimated."""
    return {}


def no_check(capture: Capture) -> None:
    """For a stage whose files are checked where the capture is recognised."""


@dataclass(frozen=True)
class Stage:
    """One stage of the pipeline.

    Fields:
        name: of its command and folder.
        version: grows whenever the meaning of its output changes.
        parameters: their dataclass.
        needs: upstream stages, read where the plan runs them.
        needed: decides whether a capture needs the stage.
        run: fills one folder.
        capture_files: the capture's files that it reads itself; they enter its key.
        check: raises UserError where it could not use its files; asked before any stage runs.
        given_files: files that its parameters name; they enter its key, and it may refuse them before anything runs.
        config: `capture.toml` sections that it heeds; they enter its key.
        environments: it reads the maps to relight under.
        device: it runs on the device that a call names (every other stage runs on the processor and loads nothing to find out).
        memory: MiB that it will have at its peak, with so many jobs side by side.
        costs: its parts (ITSELF, COMPILING and its passes, whether they run or not), and what each takes.
        parallel: share of its processor time that spreads over the cores.
    """

    name: str
    version: int
    parameters: type
    needs: tuple[str, ...]
    needed: Callable[[Capture, Any], Decision]
    run: Callable[[StageRun], None]
    capture_files: Callable[[Capture], Iterable[Path]] = no_files
    check: Callable[[Capture], None] = no_check
    given_files: Callable[[Capture, Any], Iterable[Path]] = no_given_files
    config: tuple[str, ...] = ()
    environments: bool = False
    device: bool = False
    memory: Callable[[Capture, Any, int], float] = little_memory
    costs: Callable[[Capture, Any], Mapping[str, Cost]] = no_costs
    parallel: float = 0.0


@dataclass
class StageRun:
    """What a stage's `run` is given.

    Fields:
        capture: as recognised.
        parameters: an instance of the stage's parameters.
        inputs: the published folders of the upstream stages that ran, by stage.
        output: the folder to fill; it appears under its key when `run` returns.
        scratch: a folder that outlives a kill, for checkpoints of this very key.
        device: "cpu" or "cuda".
        environments: maps to relight under.
        progress: where to report.
        jobs: pieces that may be worked on side by side.
        warnings: said so far (`warn`).
        facts: kept so far (`note`).
        left_out: what the plan leaves out, by STAGE or STAGE.PASS: {"saved_s", "saved_mb", "reason"} each.
        partial: only some of the capture's views or lights are there (a look before a run): nothing that takes all can be told.
    """

    capture: Capture
    parameters: Any
    inputs: Mapping[str, Path]
    output: Path
    scratch: Path
    device: str = "cpu"
    environments: tuple[Path, ...] = ()
    progress: Progress = field(default_factory=Progress)
    jobs: int = 1
    warnings: list[str] = field(default_factory=list)
    facts: dict[str, Any] = field(default_factory=dict)
    left_out: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    partial: bool = False

    def warn(self, text: str) -> None:
        """Tell the user of something that does not stop the work; kept in the manifest."""
        self.warnings.append(text)
        self.progress.say(f"warning: {text}")

    def note(self, key: str, value: Any) -> None:
        """Keep a JSON-able fact of this run in the manifest (such as a pass that was left out, and why)."""
        self.facts[key] = value

    def of_light_stage(self) -> StageRun:
        """The same run for the light stage alone, of a capture that has one beside its views (else the run itself).

        Inputs that keep the light stage's files apart from the views', in a folder olat/, are taken there.
        """
        if self.capture.olat is None:
            return self
        inputs = {name: folder / OLAT if (folder / OLAT).is_dir() else folder for name, folder in self.inputs.items()}
        return dataclasses.replace(self, capture=self.capture.olat, inputs=inputs)


def parameters_from(stage: Stage, overrides: Mapping[str, Any], source: str, text: bool = True) -> Any:
    """The stage's parameters with `overrides` applied: as written in a call, or (not `text`) as TOML reads them.

    Parameters with a `preset` have `PRESETS`, values by its name of what `overrides` does not give. Raises UserError naming
    the key.
    """
    types_by_name = typing.get_type_hints(stage.parameters)
    known = [f.name for f in dataclasses.fields(stage.parameters)]
    values = {}
    for key, value in overrides.items():
        name = key.replace("-", "_")
        if name not in known:
            raise UserError(source, f"{stage.name} has no parameter {key!r}", nearest(key, known))
        values[name] = typed(value, types_by_name[name], f"{stage.name}.{key}", source, text)
    preset = getattr(stage.parameters, "PRESETS", {}).get(values.get("preset"), {})
    try:
        return stage.parameters(**{**preset, **values})
    except ValueError as error:
        raise UserError(source, f"{stage.name}: {error}", "choose another value") from error
