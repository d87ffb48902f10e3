"""What a call was given, and what a dataset remembers of the last one: parameters and environment maps."""

from __future__ import annotations

import os
import shlex
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from pipeline.capture import Capture
from pipeline.capture.naming.safe_names import environment_name, fault_of_name
from pipeline.engine.plan import parse_overrides
from pipeline.engine.stage import Stage, parameters_from
from pipeline.environments import DEFAULT, NO_MAPS, SHIPPED, shipped_map
from pipeline.errors import UserError, nearest
from pipeline.formats.images import image_size


@dataclass(frozen=True)
class Settings:
    """Parameters by stage and name, as text, and the maps beside the capture's own: files, names of `SHIPPED`, NO_MAPS."""

    parameters: Mapping[str, Mapping[str, str]] = field(default_factory=dict)
    environments: tuple[Path, ...] = ()

    def params_text(self) -> str:
        """The parameters as PARAMS= takes them."""
        items = [(s, k, v) for s, values in self.parameters.items() for k, v in values.items()]
        return " ".join(f"{s}.{k}={shlex.quote(str(v))}" for s, k, v in items)

    def envs_text(self) -> str:
        """The maps as ENVS= takes them."""
        return shlex.join(map(str, self.environments))

    def as_json(self, dataset: Path) -> dict[str, Any]:
        """The form kept in `dataset.json`; paths are relative to the dataset."""
        environments = [str(p) if _is_name(p) else os.path.relpath(p, dataset) for p in self.environments]
        return {"parameters": {s: dict(v) for s, v in self.parameters.items() if v}, "environments": environments}


def given_settings(params: str, envs: str, own: Mapping[str, str], stage: str, stages: Mapping[str, Stage]) -> Settings:
    """What PARAMS=, ENVS= and a stage's own flags say. Raises UserError."""
    overrides = parse_overrides(params, stages)
    if own:
        overrides[stage] = {**overrides.get(stage, {}), **own}
    try:
        paths = tuple(Path(p) for p in shlex.split(envs))
    except ValueError as error:
        raise UserError("ENVS", f"cannot be split into paths ({error})", "quote paths that hold spaces") from error
    return Settings(overrides, paths)


def remembered_settings(description: Mapping[str, Any], dataset: Path, stages: Mapping[str, Stage]) -> Settings:
    """What `dataset.json` tells of the last run; a parameter that no longer exists is forgotten."""
    kept = description.get("given", {})
    parameters: dict[str, dict[str, str]] = {}
    for name, values in kept.get("parameters", {}).items():
        if not all(isinstance(v, str | int | float) for v in values.values()):
            continue
        try:
            parameters_from(stages[name], values, "dataset.json")
        except (UserError, KeyError):
            continue
        parameters[name] = values
    given = (Path(p) for p in kept.get("environments", ()))
    return Settings(parameters, tuple(p if _is_name(p) else Path(os.path.normpath(dataset.absolute() / p)) for p in given))


def settings_of_one_stage(command: str, given: Settings, last: Settings, stages: Mapping[str, Stage]) -> Settings:
    """For the command of one stage, or report: what is given for it, and the last run's for stages that are not mentioned."""
    mine = {command, *given.parameters}  # report is no stage: it keeps the metrics stage's too
    parameters = {name: values for name, values in last.parameters.items() if name not in mine} | dict(given.parameters)
    if given.environments or (command in stages and stages[command].environments):
        return Settings(parameters, given.environments)
    return Settings(parameters, tuple(p for p in last.environments if _is_name(p) or p.is_file()))


def remember(last: Settings, used: Settings, ran: set[str], stages: Mapping[str, Stage]) -> Settings:
    """What to keep after a run of the stages `ran`: theirs as used, the others' as it was."""
    parameters = {n: v for n, v in last.parameters.items() if n not in ran} | {
        n: v for n, v in used.parameters.items() if n in ran
    }
    lit = any(stages[n].environments for n in ran)
    return Settings(parameters, used.environments if lit else last.environments)


def _is_name(path: Path) -> bool:
    """Whether what was given for a map is a word of ours and no file."""
    return str(path) in (*SHIPPED, NO_MAPS) and not path.is_file()


def with_environments(capture: Capture, extra: tuple[Path, ...]) -> Capture:
    """The capture with further maps, each name once; with those of `DEFAULT` where neither it nor the call has any.

    extra: files, or names of maps that come with the program; NO_MAPS alone: no others than the capture's. Raises UserError.
    """
    if not capture.environments and not extra:
        extra = tuple(Path(name) for name in DEFAULT)
    dark = [path for path in extra if str(path) == NO_MAPS and _is_name(path)]
    if dark and len(extra) > 1:
        raise UserError("ENVS", f"{NO_MAPS} stands beside maps", f"leave out {NO_MAPS} or the maps")
    by_name: dict[str, Path] = {}
    for path in [*capture.environments, *(() if dark else map(_found, extra))]:
        _check_map(path)
        name = environment_name(path)
        other = by_name.setdefault(name, path)
        if other.absolute() != path.absolute():
            raise UserError(path, f"has the same name as {other}", "rename one of them: results are named after the map")
    return replace(capture, environments=tuple(by_name.values()))


def _found(path: Path) -> Path:
    """The file of a map as given."""
    if path.is_file():
        return path
    if (shipped := shipped_map(str(path))) is not None:
        return shipped
    remedy = nearest(str(path), [*SHIPPED, NO_MAPS]) if not path.suffix and path.parent == Path() else "check ENVS="
    raise UserError(path, "no such environment map", remedy)


def _check_map(path: Path) -> None:
    """Refuse now, not after the training, what cannot be relit under."""
    if not path.is_file():
        raise UserError(path, "no such environment map", "check ENVS=")
    if path.suffix.lower() not in (".hdr", ".exr"):
        raise UserError(path, "is not an .hdr or .exr file", "convert the map to one of these")
    width, height = image_size(path)
    if width != 2 * height:
        fault = f"is {width}x{height}: a latitude-longitude map is twice as wide as high"
        raise UserError(path, fault, "convert it to that projection")
    if wrong := fault_of_name(environment_name(path)):
        raise UserError(path, f"its name {wrong}, and results are named after it", "rename the map")
