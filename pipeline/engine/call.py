"""One call of the command: its options, and what they come to: capture, dataset, settings."""

from __future__ import annotations

import argparse
import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from pipeline.capture import Capture
from pipeline.engine.dataset import Dataset, digest_json
from pipeline.engine.places import open_places
from pipeline.engine.plan import Step, plan_as_json
from pipeline.engine.program import Program
from pipeline.engine.progress import Progress
from pipeline.engine.settings import (
    Settings,
    given_settings,
    remembered_settings,
    settings_of_one_stage,
    with_environments,
)
from pipeline.engine.stage import Stage


@dataclass(frozen=True)
class Call:
    """One call of the command: its options, and what they come to."""

    program: Program
    options: argparse.Namespace
    stages: Mapping[str, Stage]
    capture: Capture
    dataset: Dataset
    settings: Settings
    last: Settings
    progress: Progress

    @property
    def command(self) -> str:
        """What was asked for."""
        return self.options.command


def open_call(program: Program, options: argparse.Namespace, stages: Mapping[str, Stage]) -> Call:
    """What the options of a command come to. Raises UserError."""
    capture, dataset = open_places(options.capture, options.dataset, options.command)
    own = {k[2:]: v for k, v in vars(options).items() if k.startswith("p_") and v is not None}
    given = given_settings(options.params, options.envs, own, options.command, stages)
    last = remembered_settings(dataset.read_description(), dataset.root, stages)
    inherits = (options.command in stages and not options.alone) or options.command == "report"
    settings = settings_of_one_stage(options.command, given, last, stages) if inherits else given
    capture = with_environments(capture, settings.environments)
    return Call(program, options, stages, capture, dataset, settings, last, Progress(quiet=options.quiet))


def describe(call: Call, steps: list[Step], kept: Settings) -> None:
    """Write `dataset.json`: plan, decisions that finished stages took at run time, and the user's settings."""
    plan, dataset = plan_as_json(steps), call.dataset
    for step in steps:
        version = dataset.find(step.stage.name, step.key) if step.decision.run else None
        facts = version.manifest.get("facts", {}) if version else {}
        passes = {k: v for k, v in facts.items() if isinstance(v, dict) and {"run", "reason"} <= set(v)}
        if passes:
            plan[step.stage.name]["passes"] = {**plan[step.stage.name].get("passes", {}), **passes}
    fingerprint = digest_json([step.inputs.get("files", {}) for step in steps])
    where = os.path.relpath(call.capture.root, dataset.root)
    facts = {"capture": where, "layout": call.capture.layout, "fingerprint": fingerprint, "plan": plan}
    dataset.describe({**facts, "given": kept.as_json(dataset.root)})


def place_of(call: Call, stage: str) -> Path:
    """Where a stage's version in use lies."""
    version = call.dataset.current(stage)
    return call.dataset.place(version) if version else call.dataset.root / stage / "current"
