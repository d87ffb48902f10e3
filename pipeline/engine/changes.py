"""What a dataset already holds of a plan: done, to be made again and why, to be resumed; and what that took before."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

from pipeline.engine.costs.estimate import Expected, LeftOut
from pipeline.engine.dataset import Dataset, Version
from pipeline.engine.dataset.documents import read_object
from pipeline.engine.plan import Step, as_json
from pipeline.engine.progress import brief
from pipeline.engine.settings import Settings
from pipeline.engine.stage import Stage

Kind = Literal["skip", "run", "done", "again", "switch", "resume"]
WORDS: dict[Kind, str] = {
    "skip": "skip", "run": "run", "done": "done", "again": "redo", "switch": "use", "resume": "resume",
}  # fmt: skip
NAMED = 2  # changed files that are named; more are counted


@dataclass(frozen=True)
class State:
    """How one step of a plan stands in a dataset.

    Fields:
        kind: left out, never made, in use, to be made again, made earlier and to be put to use, begun and to be resumed.
        why: what differs from the version in use.
        root: the difference is this stage's own, not of one upstream.
        wall_s: seconds that it took, or that another version of it took last; None where none is known.
        expected: what it will take; None where nothing is to be done, or is known.
        saved: what the plan saves by leaving the stage out (by the name "") or a pass of it.
    """

    kind: Kind
    why: str = ""
    root: bool = False
    wall_s: float | None = None
    expected: Expected | None = None
    saved: Mapping[str, LeftOut] = field(default_factory=dict)

    @property
    def ready(self) -> bool:
        """No work to be done."""
        return self.kind in ("skip", "done", "switch")


def states(dataset: Dataset, steps: Sequence[Step]) -> dict[str, State]:
    """The state of every step, by stage. A plan without keys (of a dataset that does not exist) is all to be run."""
    return {step.stage.name: _state(dataset, step) for step in steps}


def _state(dataset: Dataset, step: Step) -> State:
    name = step.stage.name
    if not step.decision.run:
        return State("skip")
    current = dataset.current(name)
    if not step.key:
        return State("run")
    version = dataset.find(name, step.key)
    if version is not None and current is not None and current.key == step.key:
        return State("done", wall_s=_wall_s(version))
    why, root = differences(current.manifest, step) if current else ("", False)
    if version is not None:
        return State("switch", why, root, _wall_s(version))
    spent = _unfinished_s(dataset, step)
    if spent is not None:
        return State("resume", f"after {brief(spent)} of work", root, _last_wall_s(dataset, name, current))
    return State("again" if current else "run", why, root, _last_wall_s(dataset, name, current))


def _wall_s(version: Version) -> float | None:
    wall = version.manifest.get("wall_s")
    return float(wall) if isinstance(wall, int | float) else None


def _last_wall_s(dataset: Dataset, stage: str, current: Version | None) -> float | None:
    if current is not None:
        return _wall_s(current)
    made = sorted(dataset.versions(stage), key=lambda v: str(v.manifest.get("started", "")))
    return _wall_s(made[-1]) if made else None


def _unfinished_s(dataset: Dataset, step: Step) -> float | None:
    """Seconds of work that a killed run left behind with a checkpoint, or None."""
    work = dataset.work_folder(step.stage.name, step.key)
    try:
        begun = any((work / "scratch").iterdir())
    except OSError:
        return None
    wall = (read_object(work / "usage.json") or {}).get("wall_s")
    return float(wall) if begun and isinstance(wall, int | float) else None


def differences(manifest: Mapping[str, Any], step: Step) -> tuple[str, bool]:
    """What makes a step another than the version of `manifest`, in words; and whether that is the stage's own doing."""
    own: list[str] = []
    was, now = manifest.get("parameters", {}), as_json(step.parameters)
    for key in dict.fromkeys([*now, *was]):
        if key in was and key in now and was[key] != now[key]:
            own.append(f"{key} was {_short(was[key])} and is {_short(now[key])}")
    before, after = manifest.get("inputs", {}), step.inputs
    own += _file_differences(before.get("files", {}), after.get("files", {}))
    old_facts, new_facts = before.get("capture", {}), after.get("capture", {})
    if (a := len(old_facts.get("views", ()))) != (b := len(new_facts.get("views", ()))):
        own.append(f"the capture had {a} view{'s' * (a != 1)} and has {b}")
    changed = [k for k in new_facts if k != "views" and k in old_facts and old_facts[k] != new_facts[k]]
    own += [
        "the capture's layout has changed" if k == "layout" else f"what capture.toml says of {k} has changed" for k in changed
    ]
    if manifest.get("version") != step.stage.version:
        own.append("the program has changed")
    if own:
        return ", ".join(own), True
    upstream_was, upstream_is = before.get("stages", {}), after.get("stages", {})
    follows = [n for n in {**upstream_was, **upstream_is} if upstream_was.get(n) != upstream_is.get(n)]
    return (f"follows {follows[0]}" if follows else "its inputs have changed"), not follows


def _file_differences(was: Mapping[str, str], now: Mapping[str, str]) -> list[str]:
    kinds = {
        "changed": [f for f in now if f in was and was[f] != now[f]],
        "new": [f for f in now if f not in was],
        "no longer given": [f for f in was if f not in now],
    }
    out = []
    for word, files in kinds.items():
        if files:
            names = f"{len(files)} files" if len(files) > NAMED else " and ".join(files)
            verb = ("have" if word == "changed" else "are") if len(files) > 1 else ("has" if word == "changed" else "is")
            out.append(f"{names} {verb} {word}")
    return out


def _short(value: Any) -> str:
    text = str(value).lower() if isinstance(value, bool) else str(value)
    return text if len(text) <= 40 else text[:37] + "..."


def stale_after(dataset: Dataset, steps: Sequence[Step]) -> list[str]:
    """Stages whose version in use was made from other versions than those in use, or from such a one."""
    stale: list[str] = []
    for step in steps:
        version = dataset.current(step.stage.name)
        if version is None or not step.decision.run:
            continue
        used = version.manifest.get("inputs", {}).get("stages", {})
        if any(n in stale or _in_use(dataset, n) not in (None, key) for n, key in used.items()):
            stale.append(step.stage.name)
    return stale


def _in_use(dataset: Dataset, stage: str) -> str | None:
    version = dataset.current(stage)
    return version.key if version else None


def standing(state: State) -> str:
    """Say how a step stands: what differs, what it will take, and what it took last.

    Args:
        state: the step's.

    Returns:
        The words; "" where nothing is known.
    """
    took = "" if state.wall_s is None else f"took {brief(state.wall_s)}"
    if state.kind == "done":
        return f"done, {took}" if took else "done"
    if state.kind == "switch":
        return f"an earlier version ({state.why})" if state.why else "a version that was made before"
    will = f"about {brief(state.expected.wall_s)}" if state.expected is not None else ""
    return ", ".join(filter(None, [state.why, will, f"{took} last time" if took else ""]))


def expected_warnings(at_once: Sequence[str], dataset: Dataset, found: Mapping[str, State]) -> list[str]:
    """What a run would warn of, as far as it can be known: of the capture, and what the stages that are done said."""
    kept = [v.manifest.get("warnings", []) for n, s in found.items() if s.kind == "done" and (v := dataset.current(n))]
    return list(dict.fromkeys([*at_once, *(str(w) for warnings in kept for w in warnings)]))


def keep_hint(last: Settings, now: Settings, found: Mapping[str, State], stages: Mapping[str, Stage], whole: bool) -> str:
    """Hint: the PARAMS and ENVS of the last run that this call omits, if omitting them makes stages run again; else "".

    `whole`: the call means every stage; else the hint names only the stages that lose something.
    """
    busy = [name for name, state in found.items() if state.kind not in ("skip", "done")]
    lost = [n for n in busy if any(now.parameters.get(n, {}).get(k) != v for k, v in last.parameters.get(n, {}).items())]
    kept = {p.absolute() for p in now.environments}
    dark = any(stages[name].environments for name in busy) and any(p.absolute() not in kept for p in last.environments)
    if not lost and not dark:
        return ""
    omitted = Settings(
        {n: v for n, v in last.parameters.items() if whole or n in lost}, last.environments if whole or dark else ()
    )
    params = f' PARAMS="{omitted.params_text()}"' if omitted.parameters else ""
    envs = f' ENVS="{omitted.envs_text()}"' if omitted.environments else ""
    return f"the last run was given{params}{envs}: give that again to keep its results"
