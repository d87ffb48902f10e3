"""What this scene needs: which stages run with which parameters and keys, and why the others do not."""

from __future__ import annotations

import dataclasses
import importlib
import shlex
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pipeline.capture import Capture
from pipeline.engine.dataset import DigestCache
from pipeline.engine.dataset.versions import content_key
from pipeline.engine.stage import Decision, Stage, parameters_from
from pipeline.errors import UserError, nearest

Overrides = Mapping[str, Mapping[str, Any]]  # stage name -> parameter -> value


@dataclass(frozen=True)
class Step:
    """One stage of a plan.

    Fields:
        stage: which.
        decision: whether it runs, and why.
        parameters: an instance of the stage's parameters.
        key: content address of its version; "" where it does not run.
        inputs: what the key is made of.
        needs: the upstream stages that run.
        files: of the capture and the maps, that the stage reads itself.
    """

    stage: Stage
    decision: Decision
    parameters: Any
    key: str = ""
    inputs: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    needs: tuple[str, ...] = ()
    files: tuple[Path, ...] = ()  # of the capture and the maps, that the stage reads itself


def load_stages(modules: Mapping[str, str]) -> dict[str, Stage]:
    """Import each stage's description (light: no stage loads its heavy libraries for this)."""
    return {name: importlib.import_module(f"{module}.stage").STAGE for name, module in modules.items()}


def parse_overrides(text: str, stages: Mapping[str, Stage]) -> dict[str, dict[str, str]]:
    """`train.iterations=500 olat.solver=closed` as {stage: {parameter: value}}. Raises UserError."""
    out: dict[str, dict[str, str]] = {}
    try:
        items = shlex.split(text)
    except ValueError as error:
        raise UserError("PARAMS", f"cannot be split ({error})", "quote values that hold spaces") from error
    for item in items:
        left, equals, value = item.partition("=")
        stage, dot, name = left.partition(".")
        if not (equals and dot and name):
            raise UserError("PARAMS", f"{item!r} is not of the form stage.parameter=value", "as in train.iterations=500")
        if stage not in stages:
            raise UserError("PARAMS", f"there is no stage {stage!r}", nearest(stage, stages))
        out.setdefault(stage, {})[name] = value
    return out


def make_plan(
    capture: Capture,
    stages: Mapping[str, Stage],
    overrides: Overrides,
    environments: tuple[Path, ...],
    digests: DigestCache | None,
) -> list[Step]:
    """Decide every stage for a capture and give each that runs its key (no key without `digests`). Raises UserError."""
    for name in capture.config.stage:
        if name not in stages:
            path = capture.config.path or capture.root
            raise UserError(path, f"[stage.{name}] names no stage", nearest(name, stages))
    steps: dict[str, Step] = {}
    for name, stage in stages.items():
        from_file = capture.config.stage.get(name, {})
        parameters_from(stage, from_file, str(capture.config.path), text=False)  # so that a fault there is laid at its door
        parameters = parameters_from(stage, {**from_file, **overrides.get(name, {})}, "PARAMS")
        decision = stage.needed(capture, parameters)
        if not decision.run:
            steps[name] = Step(stage, decision, parameters)
            continue
        needs = tuple(n for n in stage.needs if steps[n].decision.run)
        given = tuple(stage.given_files(capture, parameters))
        if digests is None:
            steps[name] = Step(stage, decision, parameters, needs=needs)
            continue
        files = [*stage.capture_files(capture), *given, *(environments if stage.environments else ())]
        inputs = {
            "stages": {n: steps[n].key for n in needs},
            "files": digests.digests(capture.root, files),
            "capture": _capture_facts(capture, stage),
        }
        content = {"stage": name, "version": stage.version, "parameters": as_json(parameters), "inputs": inputs}
        steps[name] = Step(stage, decision, parameters, content_key(content), inputs, needs, tuple(files))
    return list(steps.values())


def _capture_facts(capture: Capture, stage: Stage) -> dict[str, Any]:
    """What a stage heeds of the capture beside the bytes of its files."""
    sections = {name: as_json(getattr(capture.config, name)) for name in stage.config}
    parts = {"parts": capture.parts} if capture.parts is not None else {}
    return {"layout": capture.layout, "views": [v.view for v in capture.views], **parts, **sections}


def as_json(value: Any) -> Any:
    """Dataclasses, tuples and paths as plain JSON values."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {f.name: as_json(getattr(value, f.name)) for f in dataclasses.fields(value)}
    if isinstance(value, Mapping):
        return {str(k): as_json(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [as_json(v) for v in value]
    return str(value) if isinstance(value, Path) else value


def plan_as_json(steps: list[Step]) -> dict[str, Any]:
    """Write a plan as `dataset.json` keeps it.

    Args:
        steps: the plan.

    Returns:
        Stage to its decision.
    """
    return {step.stage.name: step.decision.as_json() for step in steps}
