"""The `polarfield` command: `all`, one command per stage, `plan`, `inspect`, `report`, `gc`."""

from __future__ import annotations

import argparse
import dataclasses
import os
import shlex
import signal
import subprocess
import sys
import typing
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from pipeline.capture import Capture, open_capture
from pipeline.dataset import Dataset, digest_json
from pipeline.errors import UserError
from pipeline.images import image_size
from pipeline.plan import Step, load_stages, make_plan, parse_overrides, plan_as_json, plan_as_text
from pipeline.progress import Progress
from pipeline.stage import Stage

EPILOG = "A capture folder is never written to. docs/captures.md lists what is recognised; docs/stages.md what comes out."
COMMANDS = {
    "all": "run every stage that the capture needs",
    "plan": "print what would run, and why",
    "inspect": "write a page that shows what was understood of a capture, before anything long runs",
    "report": "bring the metrics up to date and say where the report lies",
    "gc": "remove versions that are not in use, and abandoned work",
}


def main(modules: Mapping[str, str], arguments: Sequence[str]) -> int:
    """Run one command; returns the exit status: 0 done, 2 a fault of input, 130 interrupted."""
    try:
        return _run(modules, arguments)
    except UserError as error:
        print(f"polarfield: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("polarfield: interrupted; the same command resumes where it can", file=sys.stderr)
        return 130
    except BrokenPipeError:
        return 0


def stage_main(name: str) -> None:
    """Entry of `python -m stages.NAME`."""
    from stages import STAGES

    sys.exit(main(STAGES, [name, *sys.argv[1:]]))


def _run(modules: Mapping[str, str], arguments: Sequence[str]) -> int:
    stages = load_stages(modules)
    options = _parser(stages).parse_args(list(arguments))
    options.argv = list(arguments)
    if options.command == "gc":
        return _collect(options)
    capture_path, dataset_path = _paths(options)
    capture = open_capture(capture_path)
    dataset = Dataset(dataset_path)
    environments = _environments(options, capture)
    capture = dataclasses.replace(capture, environments=environments)  # with those of ENVS=
    overrides: dict[str, dict[str, Any]] = dict(parse_overrides(options.params, stages))
    if options.command in stages:
        given = {k[2:]: v for k, v in vars(options).items() if k.startswith("p_") and v is not None}
        overrides[options.command] = {**overrides.get(options.command, {}), **given}
    progress = Progress(quiet=options.quiet)
    if options.command in ("plan", "inspect"):
        steps = make_plan(capture, stages, overrides, environments, None)
        print(f"{capture.root.name}: {capture.layout}\n{plan_as_text(steps)}")
        if options.command == "inspect":
            from pipeline.report.inspect import write_inspection

            print(f"inspection: {write_inspection(capture, steps, dataset_path.with_name(dataset_path.name + '-inspect'))}")
        return 0
    dataset.prepare()
    for warning in () if options.alone else capture.warnings:
        progress.say(f"warning: {warning}")
    steps = make_plan(capture, stages, overrides, environments, dataset.digests)
    dataset.digests.save(dataset.write_text)
    return _bring_up_to_date(options, capture, dataset, steps, environments, progress)


def _bring_up_to_date(
    options: argparse.Namespace,
    capture: Capture,
    dataset: Dataset,
    steps: list[Step],
    environments: tuple[Path, ...],
    progress: Progress,
) -> int:
    wanted = _wanted(steps, {"all": None, "report": "metrics"}.get(options.command, options.command))
    if options.alone:
        from pipeline.execute import make_version

        step = next(s for s in steps if s.stage.name == options.command)
        device = _device(options.device)
        make_version(dataset, capture, step, environments, device, options.jobs, progress)
        return 0
    target = next((s for s in steps if s.stage.name == options.command), None)
    if target is not None and not target.decision.run:
        print(f"{target.stage.name}: not needed ({target.decision.reason})")
        return 0
    _describe(dataset, capture, steps)
    if options.command == "all" and any(dataset.find(s.stage.name, s.key) is None for s in wanted):
        for step in steps:
            if not step.decision.run:
                progress.say(f"{step.stage.name}: left out ({step.decision.reason})")
    made = 0
    for step in wanted:
        version = dataset.find(step.stage.name, step.key)
        if version is None:
            status = _in_a_process_of_its_own(step.stage.name, capture, dataset, environments, options)
            version = dataset.find(step.stage.name, step.key)
            if status or version is None:
                return status or 1
            made += 1
        dataset.use(version)
    _describe(dataset, capture, steps)
    if not made:
        print(f"{dataset.root}: up to date, nothing to do")
    report = dataset.root / "metrics" / "current" / "report.html"
    if wanted and wanted[-1].stage.name == "metrics" and report.exists():
        print(f"report: {report}")
    return 0


def _wanted(steps: list[Step], target: str | None) -> list[Step]:
    """The steps to bring up to date: all that run, or the target with everything upstream of it."""
    running = [s for s in steps if s.decision.run]
    if target is None:
        return running
    names, out = {target}, []
    for step in reversed(running):
        if step.stage.name in names:
            names.update(step.needs)
            out.append(step)
    return out[::-1]


def _in_a_process_of_its_own(
    name: str, capture: Capture, dataset: Dataset, environments: tuple[Path, ...], options: argparse.Namespace
) -> int:
    """Run one stage in a child: its memory is its own, and a crash of a native library ends the stage alone."""
    command = [sys.executable, "-m", "stages", name, str(capture.root), "--dataset", str(dataset.root), "--alone"]
    command += ["--params", options.params, "--envs", shlex.join(map(str, _extra_environments(options)))]
    command += ["--device", options.device, "--jobs", str(options.jobs)] + (["--quiet"] if options.quiet else [])
    if name == options.command:
        for key, value in vars(options).items():
            if key.startswith("p_") and value is not None:
                command += [f"--{key[2:].replace('_', '-')}={value}"]
    path = os.pathsep.join(filter(None, [str(Path(__file__).parents[1]), os.environ.get("PYTHONPATH", "")]))
    sys.stdout.flush()
    child = subprocess.Popen(command, env={**os.environ, "PYTHONPATH": path}, preexec_fn=_die_with_parent)
    try:
        status = child.wait()
    except KeyboardInterrupt:
        child.wait()
        raise
    if status < 0:
        why = signal.Signals(-status).name
        hint = "it may have run out of memory; " if status == -signal.SIGKILL else ""
        raise UserError(name, f"the stage was ended by {why}", f"{hint}`make {name}` resumes it")
    return status


def _die_with_parent() -> None:
    """Ask Linux to kill this process when its parent dies, so that a kill of `make all` leaves nothing running."""
    import ctypes

    pr_set_pdeathsig = 1
    ctypes.CDLL(None).prctl(pr_set_pdeathsig, signal.SIGKILL)


def _describe(dataset: Dataset, capture: Capture, steps: list[Step]) -> None:
    """Write `dataset.json`: the plan, with the passes that finished stages decided on by what they saw."""
    plan = plan_as_json(steps)
    for step in steps:
        version = dataset.find(step.stage.name, step.key) if step.decision.run else None
        facts = version.manifest.get("facts", {}) if version else {}
        passes = {k: v for k, v in facts.items() if isinstance(v, dict) and {"run", "reason"} <= set(v)}
        if passes:
            plan[step.stage.name]["passes"] = {**plan[step.stage.name].get("passes", {}), **passes}
    fingerprint = digest_json([step.inputs.get("files", {}) for step in steps])
    where = os.path.relpath(capture.root, dataset.root)
    dataset.describe({"capture": where, "layout": capture.layout, "fingerprint": fingerprint, "plan": plan})


def _paths(options: argparse.Namespace) -> tuple[Path, Path]:
    """The capture and the dataset folder; either tells the other where one is not given."""
    if options.capture:
        capture = Path(options.capture)
        return capture, Path(options.dataset or Path("datasets") / capture.absolute().name)
    if options.dataset:
        recorded = Dataset(Path(options.dataset)).read_description().get("capture")
        if recorded:
            return Path(os.path.normpath(Path(options.dataset).absolute() / recorded)), Path(options.dataset)
        raise UserError(options.dataset, "holds no dataset that tells its capture", "check DATASET=, or give CAPTURE= too")
    raise UserError("CAPTURE", "no capture folder was given", f"as in `make {options.command} CAPTURE=folder`")


def _extra_environments(options: argparse.Namespace) -> list[Path]:
    try:
        return [Path(p) for p in shlex.split(options.envs)]
    except ValueError as error:
        raise UserError("ENVS", f"cannot be split into paths ({error})", "quote paths that hold spaces") from error


def _environments(options: argparse.Namespace, capture: Capture) -> tuple[Path, ...]:
    """The capture's maps and those of ENVS, each name once. Raises UserError."""
    by_name: dict[str, Path] = {}
    for path in [*capture.environments, *_extra_environments(options)]:
        if not path.is_file():
            raise UserError(path, "no such environment map", "check ENVS=")
        if path.suffix.lower() not in (".hdr", ".exr"):
            raise UserError(path, "is not an .hdr or .exr file", "convert the map to one of these")
        width, height = image_size(path)
        if width != 2 * height:  # told now, not after the training
            fault = f"is {width}x{height}: a latitude-longitude map is twice as wide as high"
            raise UserError(path, fault, "convert it to that projection")
        other = by_name.setdefault(path.stem, path)
        if other.absolute() != path.absolute():
            raise UserError(path, f"has the same name as {other}", "rename one of them: results are named after the map")
    return tuple(by_name.values())


def _device(choice: str) -> str:
    if choice != "auto":
        return choice
    import importlib.util

    if not Path("/dev/nvidiactl").exists() or importlib.util.find_spec("gsplat") is None:
        return "cpu"  # decided without importing torch
    import torch

    return "cuda" if torch.cuda.is_available() else "cpu"


def _collect(options: argparse.Namespace) -> int:
    _, path = _paths(options)
    if not path.is_dir():
        raise UserError(path, "no such dataset", "check DATASET=")
    gone = Dataset(path).collect()
    print("\n".join(f"removed {p}" for p in gone) or f"{path}: nothing to remove")
    return 0


def _parser(stages: Mapping[str, Stage]) -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="polarfield", description=__doc__, epilog=EPILOG)
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    for name, text in COMMANDS.items():
        _common(commands.add_parser(name, help=text, description=text, epilog=EPILOG))
    for name, stage in stages.items():
        text = f"run the {name} stage and what it needs"
        sub = commands.add_parser(name, help=text, description=text, epilog=EPILOG)
        _common(sub)
        group = sub.add_argument_group(f"{name} parameters")
        hints = typing.get_type_hints(stage.parameters)
        for f in dataclasses.fields(stage.parameters):
            choices = typing.get_args(hints[f.name]) if typing.get_origin(hints[f.name]) is typing.Literal else None
            default = getattr(stage.parameters(), f.name)
            note = f"{f.metadata.get('help', '')} [default: {default}]".replace("%", "%%")
            if choices:
                note += f" one of {', '.join(map(str, choices))}"
            flag = "--" + f.name.replace("_", "-")
            group.add_argument(flag, dest=f"p_{f.name}", default=None, metavar="VALUE", help=note)
    return parser


def _common(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    add("capture", nargs="?", default="", help="the capture folder (default: the one that DATASET was made from)")
    add("--dataset", default="", help="the dataset directory [default: datasets/<capture folder's name>]")
    add("--params", default="", metavar="TEXT", help='parameters of any stage, as "train.iterations=500 olat.solver=closed"')
    add("--envs", default="", metavar="TEXT", help='more environment maps to relight under, as "a.hdr b.exr"')
    add("--device", default="auto", choices=("auto", "cpu", "cuda"), help="where to train [default: auto]")
    add("--jobs", type=int, default=1, help="how many independent pieces to work on side by side [default: 1]")
    add("--quiet", action="store_true", help="say nothing but errors and the result")
    add("--alone", action="store_true", help=argparse.SUPPRESS)
