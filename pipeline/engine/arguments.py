"""The command line of `polarfield`: its options, and one line for whatever is wrong with them."""

from __future__ import annotations

import argparse
import dataclasses
import re
import typing
from collections.abc import Mapping, Sequence
from typing import Any, NoReturn

from pipeline.engine.completion import SHELLS
from pipeline.engine.examples import ending
from pipeline.engine.memory import parsed_mb
from pipeline.engine.stage import Stage
from pipeline.environments import DEFAULT, NO_MAPS, SHIPPED
from pipeline.errors import UserError, nearest

EPILOG = "A capture folder is never written to. docs/captures.md lists what is recognised; docs/stages.md what comes out. "
COMMANDS = {
    "all": "run every stage that the capture needs, with exactly the parameters and maps that are given",
    "plan": "print what `all` would run, what is done already, and why",
    "inspect": "write a page that shows what was understood of a capture, before anything long runs",
    "report": "write the report of the results in use and say where it lies; runs no other stage",
    "compare": "show results side by side, figures and pictures: datasets, or versions of them (DATASET/metrics/VERSION)",
    "export": "copy results to a folder of their own, in a format that other programs open",
    "tradeoff": "run a capture with other parameters, for up to ten times its own time: error against seconds",
    "verify": "read everything in use against its digests and name what is damaged or missing (then the exit status is 1)",
    "batch": "run every stage of every capture in a folder, or of those that a list names, and write one table",
    "completion": "print a script that completes commands, options and their values in bash, zsh or fish",
    "gc": "remove versions that nothing in use was made from, and unfinished work; lists them, and asks unless --yes is given",
}
SWITCHES = {
    "batch": {
        "--dry-run": "tell what is done and what is left, and run nothing",
        "--slurm": "submit a Slurm array, a task a capture, and a last job that writes the table",
    },
    "gc": {"--dry-run": "list what would go, and remove nothing", "--yes": "do not ask"},
    "verify": {
        "--full": "read all files again, also those that were found whole and were not written to since",
        "--repair": "drop what is damaged, so that the next run makes exactly that again",
    },
}
VALUES: dict[str, dict[str, dict[str, Any]]] = {
    "batch": {
        "--snakemake": {"nargs": "?", "const": "", "metavar": "TEXT",
                        "help": "run on Snakemake, given TEXT, as in --snakemake='--executor slurm'"},
        "--sbatch": {"default": "", "metavar": "TEXT", "help": "more options of sbatch, as in --sbatch='--time=4:00:00'"},
        "--cores": {"type": int, "default": 4, "metavar": "N", "help": "processor cores of a job on a cluster [default: 4]"},
        "--round": {"type": int, "default": 1, "help": argparse.SUPPRESS},
    }
}  # fmt: skip
MAKE_VARIABLES = {
    "--dataset": "DATASET",
    "--params": "PARAMS",
    "--envs": "ENVS",
    "--device": "DEVICE",
    "--jobs": "JOBS",
    "--memory": "MEMORY",
}
DEVICES = ("auto", "cpu", "cuda")
MAPS_HELP = (
    f'more environment maps to relight under, as "a.hdr b.exr", or of those that come with the program: {", ".join(SHIPPED)} '
    f"[default: {' '.join(DEFAULT)} where the capture has none of its own; {NO_MAPS}: none]"
)
OTHER_NAMES = {"gpu": "cuda", "nvidia": "cuda"}  # what people write for a device


def parse(stages: Mapping[str, Stage], arguments: Sequence[str], formats: Sequence[str] = ()) -> argparse.Namespace:
    """The options of one call; `formats`: what `export` knows.

    Raises UserError in one line that names the argument and the nearest valid one.
    """
    given = list(arguments)
    if not given:
        raise UserError("COMMAND", "none was given", f"{nearest('', [*COMMANDS, *stages])}; --help explains them")
    if not given[0].startswith("-") and given[0] not in (*COMMANDS, *stages):
        raise UserError(given[0], "is not a command", nearest(given[0], [*COMMANDS, *stages]))
    options, unknown = command_parser(stages, formats).parse_known_args(given)
    if unknown:
        flag = next((a for a in unknown if a.startswith("-")), unknown[0])
        raise _unknown(flag, options.command, stages)
    if options.command in ("compare", "completion", "export"):
        return options
    if options.jobs < 1:
        raise UserError(_spoken("--jobs"), f"{options.jobs} is not a whole number from 1 on", "as in 2")
    if getattr(options, "memory", ""):
        parsed_mb(options.memory)
    return options


def _unknown(flag: str, command: str, stages: Mapping[str, Stage]) -> UserError:
    name = flag.partition("=")[0]
    if not name.startswith("-"):
        return UserError(flag, "one capture folder is taken, this is a second", "quote a path that holds spaces")
    own = [f"--{n}" for n in (_flags(stages[command]) if command in stages else ())]
    owner = next((s for s in stages if name in {f"--{n}" for n in _flags(stages[s])}), None)
    if owner and owner != command:
        parameter = name[2:].replace("-", "_")
        return UserError(name, f"is a parameter of {owner}, not of {command}", f'as in --params "{owner}.{parameter}=VALUE"')
    near = nearest(name, [*own, *MAKE_VARIABLES, "--quiet", *SWITCHES.get(command, ()), *VALUES.get(command, ())])
    return UserError(name, f"{command} has no such option", near)


def _flags(stage: Stage) -> list[str]:
    return [f.name.replace("_", "-") for f in dataclasses.fields(stage.parameters)]


def _spoken(flag: str) -> str:
    """Name an option as `MAKE_VARIABLE (--flag)`."""
    return f"{MAKE_VARIABLES[flag]} ({flag})" if flag in MAKE_VARIABLES else flag


class _OneLineParser(argparse.ArgumentParser):
    """argparse, with faults as UserError instead of a usage block, and options by their whole names alone."""

    def __init__(self, **settings: Any) -> None:
        super().__init__(**settings, allow_abbrev=False)

    def error(self, message: str) -> NoReturn:
        """Raise argparse's complaint in the project's own form."""
        about = re.match(r"argument (\S+): (.*)", message)
        flag, fault = (_spoken(about[1]), about[2]) if about else ("COMMAND", message)
        if choice := re.match(r"invalid choice: '(.*)' \(choose from (.*)\)", fault):
            valid = re.findall(r"[\w.-]+", choice[2])
            near = f"did you mean {OTHER_NAMES[choice[1].lower()]}?" if choice[1].lower() in OTHER_NAMES else ""
            raise UserError(flag, f"{choice[1]!r} is not known", near or nearest(choice[1], valid))
        if number := re.match(r"invalid int value: (.*)", fault):
            raise UserError(flag, f"{number[1]} is not a whole number", "as in 2")
        raise UserError(flag, fault, f"`{self.prog} --help` lists the options")


def command_parser(stages: Mapping[str, Stage], formats: Sequence[str]) -> argparse.ArgumentParser:
    """The parser of every command over these stages; `formats`: what `export` knows."""
    parser = _OneLineParser(prog="polarfield", description="Captures in, datasets out.", **ending("", EPILOG))
    parser.add_argument("--version", action="version", version=f"polarfield {program_version()}", help="say the version")
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    for name, text in COMMANDS.items():
        sub = commands.add_parser(name, help=text, description=text, **ending(name, EPILOG))
        if name == "completion":
            sub.add_argument("shell", choices=SHELLS, help=f"one of {', '.join(SHELLS)}")
            continue
        if name == "compare":
            _compared(sub)
            continue
        if name == "export":
            _exported(sub, formats)
            continue
        _common(sub)
        for switch, meaning in SWITCHES.get(name, {}).items():
            sub.add_argument(switch, action="store_true", help=meaning)
        for option, settings in VALUES.get(name, {}).items():
            sub.add_argument(option, **settings)
    for name, stage in stages.items():
        text = f"run the {name} stage and what it needs; other stages keep the parameters and maps of the last run"
        brief = f"run the {name} stage and what it needs"
        sub = commands.add_parser(name, help=brief, description=text, **ending(name, EPILOG))
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


def program_version() -> str:
    """The version that is installed; of sources that were never installed, that they are."""
    from importlib.metadata import PackageNotFoundError, version

    try:
        return version("polarfield")
    except PackageNotFoundError:
        return "(sources, not installed)"


def _compared(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("datasets", nargs="+", help="two or more datasets, or versions of their metrics")
    parser.add_argument("--out", default="comparison", help="the folder to write compare.html into [default: comparison]")


def _exported(parser: argparse.ArgumentParser, formats: Sequence[str]) -> None:
    parser.add_argument("capture", nargs="?", default="", help="the capture folder (or give --dataset)")
    parser.add_argument("--dataset", default="", help="the dataset directory [default: datasets/<capture folder's name>]")
    parser.add_argument("--to", required=True, choices=formats, help=f"the format: {', '.join(formats)}")
    parser.add_argument("--out", default="", help="the folder to write [default: DATASET-FORMAT, beside the dataset]")


def _common(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    add("capture", nargs="?", default="", help="the capture folder (default: the one that DATASET was made from)")
    add("--dataset", default="", help="the dataset directory [default: datasets/<capture folder's name>]")
    add("--params", default="", metavar="TEXT", help='parameters of any stage, as "train.iterations=500 olat.solver=closed"')
    add("--envs", default="", metavar="TEXT", help=MAPS_HELP)
    add("--device", default="auto", choices=DEVICES, help="where to train: auto, cpu or cuda [default: auto]")
    add("--jobs", type=int, default=1, help="how many independent pieces to work on side by side [default: 1]")
    add("--memory", default="", metavar="AMOUNT", help="memory that may be taken, as 16G [default: what the machine has]")
    add("--quiet", action="store_true", help="say nothing but errors and the result")
    add("--alone", action="store_true", help=argparse.SUPPRESS)
