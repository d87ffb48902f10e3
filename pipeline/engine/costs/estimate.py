"""What the steps of a plan will take on this machine, and what those that are left out would have."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from pipeline.capture import Capture
from pipeline.engine.costs import COMPILING, ITSELF
from pipeline.engine.costs.probe import slowness
from pipeline.engine.costs.rates import Rate, Rates, record_of, remembered
from pipeline.engine.dataset import Dataset
from pipeline.engine.plan import Step
from pipeline.engine.stage import Decision


@dataclass(frozen=True)
class Expected:
    """What a stage will take: wall and processor seconds; `known`: a run on this machine has shown its rate. `estimate_s`: at
    the reference machine's rates, without compiling."""

    wall_s: float
    cpu_s: float
    estimate_s: float
    known: bool


@dataclass(frozen=True)
class LeftOut:
    """Something that a plan leaves out: seconds of run time and MiB of memory that it would have taken, and why it is."""

    saved_s: float
    saved_mb: float
    reason: str

    def as_json(self) -> dict[str, Any]:
        """The form in metrics.json."""
        return {"saved_s": round(self.saved_s, 3), "saved_mb": round(self.saved_mb, 1), "reason": self.reason}


Passes = Mapping[str, Mapping[str, Decision]]
"""Passes that finished stages decided on as they ran, by stage."""


class Estimator:
    """Estimates for one capture at the rates of this machine: those remembered, and those of a dataset's own manifests."""

    def __init__(self, capture: Capture, steps: Sequence[Step], dataset: Dataset, device: str) -> None:
        self.capture, self.steps, self.device = capture, steps, device
        self.rates: Rates = remembered()
        self.found: dict[str, dict[str, Decision]] = {}
        for step in steps:
            version = dataset.find(step.stage.name, step.key) if step.key else None
            if version is not None:
                self.found[step.stage.name] = decided(version.manifest.get("facts", {}))
                record = record_of(version.manifest, self.estimate_s(step))
                if record is not None:
                    self.rates.add(step.stage.name, self._device(step), record)

    def estimate_s(self, step: Step) -> float:
        """Seconds of the reference machine for what runs of a stage, without compiling."""
        costs = step.stage.costs(self.capture, step.parameters)
        passes = self._passes(step)
        return sum(
            cost.cpu_s for name, cost in costs.items()
            if name == ITSELF or (name in passes and passes[name].run)
        )  # fmt: skip

    def expected(self, step: Step) -> Expected | None:
        """What a step that runs will take; None where its stage estimates nothing."""
        costs = step.stage.costs(self.capture, step.parameters)
        if not costs:
            return None
        estimate = self.estimate_s(step)
        rate = self._rate(step, estimate)
        compiling = costs[COMPILING].cpu_s * slowness() if COMPILING in costs else 0.0  # no matter how fast the stage is
        cpu = estimate * rate.cpu
        return Expected(cpu * rate.wall + compiling, cpu + compiling, estimate, rate.known)

    def left_out(self) -> dict[str, LeftOut]:
        """What the plan leaves out, by STAGE or STAGE.PASS: whole stages first, as the plan has them."""
        out = {}
        for step in self.steps:
            costs = step.stage.costs(self.capture, step.parameters)
            if not costs:
                continue
            rate = self._rate(step, self.estimate_s(step) if step.decision.run else costs[ITSELF].cpu_s)
            per_s = rate.cpu * rate.wall
            if not step.decision.run:
                saved = costs[ITSELF]
                out[step.stage.name] = LeftOut(saved.cpu_s * per_s, saved.memory_mb, step.decision.reason)
                continue
            for name, choice in self._passes(step).items():
                if not choice.run and name in costs:
                    saved = costs[name]
                    out[f"{step.stage.name}.{name}"] = LeftOut(saved.cpu_s * per_s, saved.memory_mb, choice.reason)
        return out

    def _passes(self, step: Step) -> dict[str, Decision]:
        return {**step.decision.passes, **self.found.get(step.stage.name, {})}

    def _rate(self, step: Step, estimate_s: float) -> Rate:
        return self.rates.of(step.stage.name, self._device(step), estimate_s, step.stage.version, step.stage.parallel)

    def _device(self, step: Step) -> str:
        return self.device if step.stage.device else "cpu"


def decided(facts: Mapping[str, Any]) -> dict[str, Decision]:
    """The passes among a manifest's facts."""
    return {
        name: Decision(bool(fact["run"]), str(fact["reason"]))
        for name, fact in facts.items()
        if isinstance(fact, dict) and {"run", "reason"} <= set(fact)
    }
