"""A plan for a person: how every step stands, what it will take, and what leaving something out saves."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from pipeline.engine.changes import WORDS, State, standing
from pipeline.engine.costs.estimate import Estimator, LeftOut
from pipeline.engine.plan import Step
from pipeline.engine.progress import brief


def with_costs(found: Mapping[str, State], estimator: Estimator) -> dict[str, State]:
    """States with what the work that is left will take, and what leaving something out saves."""
    expected = {s.stage.name: estimator.expected(s) for s in estimator.steps if not found[s.stage.name].ready}
    saved: dict[str, dict[str, LeftOut]] = {}
    for name, left in estimator.left_out().items():
        stage, _, part = name.partition(".")
        saved.setdefault(stage, {})[part] = left
    return {name: replace(state, expected=expected.get(name), saved=saved.get(name, {})) for name, state in found.items()}


def plan_text(steps: Sequence[Step], found: Mapping[str, State]) -> str:
    """The plan for a person: one line a stage with its reason, below it how it stands and the passes."""
    lines, below = [], " " * 19
    for step in steps:
        state = found[step.stage.name]
        text = standing(state)
        beside = f" [{text}]" if text and state.kind in ("done", "run") else ""
        reason = step.decision.reason + saving(state.saved.get(""))
        lines.append(f"  {WORDS[state.kind]:6}  {step.stage.name:8}  {reason}{beside}")
        if text and not beside:
            lines.append(f"{below}{WORDS[state.kind]}: {text}")
        for name, choice in step.decision.passes.items():
            saved = saving(state.saved.get(name))
            lines.append(f"{below}{'with' if choice.run else 'without'} {name}: {choice.reason}{saved}")
    return "\n".join(lines)


def saving(left: LeftOut | None) -> str:
    """Say what something that is left out saves, to put behind its reason.

    Args:
        left: what it would have taken; None where nothing is known.

    Returns:
        The words in brackets after a blank; "" where nothing is known.
    """
    return f" (saves {amount(left.saved_s, left.saved_mb)})" if left is not None else ""


def amount(seconds: float, megabytes: float) -> str:
    """Say seconds and megabytes as a person does.

    Args:
        seconds: of run time.
        megabytes: of memory; under one half they are not told.

    Returns:
        The words.
    """
    time = "next to no time" if seconds < 0.05 else f"about {brief(seconds)}"
    return f"{time}, {megabytes:.0f} MB" if megabytes >= 0.5 else time


def outlook(found: Mapping[str, State]) -> str:
    """Say what is left to do and what that will take, and what the plan saves by what it leaves out.

    Args:
        found: how each step stands, by stage (`with_costs`).

    Returns:
        One line.
    """
    return "; ".join(filter(None, [_to_do(found), _saved(found)]))


def _to_do(found: Mapping[str, State]) -> str:
    left = {n: s for n, s in found.items() if not s.ready}
    if not left:
        turned = [n for n, s in found.items() if s.kind == "switch"]
        return f"nothing to make: earlier versions of {', '.join(turned)} are put to use" if turned else "all is done"
    expected = [s.expected for s in left.values() if s.expected is not None]
    if not expected:
        return f"to do: {', '.join(left)}"
    guessed = [n for n, s in left.items() if s.expected is not None and not s.expected.known]
    unsure = f" ({', '.join(guessed)}: first estimates, none has run on this machine yet)" if guessed else ""
    if len(guessed) == len(expected):
        unsure = " (a first estimate: no run on this machine has shown its speed yet)"
    return f"to do: {', '.join(left)}; about {brief(sum(e.wall_s for e in expected))} in all{unsure}"


def _saved(found: Mapping[str, State]) -> str:
    saved = [left for state in found.values() for left in state.saved.values()]
    seconds = sum(left.saved_s for left in saved)
    return f"what is left out saves about {brief(seconds)}" if seconds >= 0.05 else ""
