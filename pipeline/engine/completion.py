"""Scripts that complete the command line in bash, zsh and fish, made from its parser."""

from __future__ import annotations

import argparse
import re
from dataclasses import dataclass

SHELLS = ("bash", "zsh", "fish")


@dataclass(frozen=True)
class Option:
    """One option of a command: its flag, what its help begins with, whether it takes a value, and of which (none: any)."""

    flag: str
    meaning: str
    valued: bool
    choices: tuple[str, ...]


def script(shell: str, parser: argparse.ArgumentParser) -> str:
    """The completion script of one of SHELLS for a parser of commands."""
    commands, options = _commands(parser), _options(parser)
    return {"bash": _bash, "zsh": _zsh, "fish": _fish}[shell](commands, options)


def _subparsers(parser: argparse.ArgumentParser) -> argparse._SubParsersAction:
    return next(a for a in parser._actions if isinstance(a, argparse._SubParsersAction))


def _commands(parser: argparse.ArgumentParser) -> dict[str, str]:
    """Meaning of each command, by name."""
    return {choice.dest: _brief(choice.help or "") for choice in _subparsers(parser)._choices_actions}


def _options(parser: argparse.ArgumentParser) -> dict[str, list[Option]]:
    """The options of each command that its help shows. A stage's parameter lists its values in its help."""
    out: dict[str, list[Option]] = {}
    for name, sub in _subparsers(parser).choices.items():
        out[name] = []
        for action in sub._actions:
            if action.help == argparse.SUPPRESS or not action.option_strings:
                continue
            listed = re.search(r"one of ([\w, .+-]+)$", action.help or "")
            named = listed[1].split(", ") if listed else []
            choices = tuple(map(str, action.choices or named))
            if not choices and re.search(r"\[default: (True|False)\]", action.help or ""):
                choices = ("true", "false")
            out[name].append(Option(action.option_strings[-1], _brief(action.help or ""), action.nargs != 0, choices))
    return out


def _brief(text: str) -> str:
    """The first clause of a help text, without what shells take for their own."""
    return re.sub(r"[^\w ./+-]", "", re.split(r"[:;,(\[]", text)[0]).strip()


def _words(commands: dict[str, str], options: dict[str, list[Option]]) -> list[str]:
    """Lines of a `case` of sh over "COMMAND OPTION" that set the variable `words`."""
    lines = []
    for name, known in options.items():
        for option in known:
            if option.choices:
                lines.append(f'    "{name} {option.flag}") words="{" ".join(option.choices)}" ;;')
        lines.append(f'    "{name} "*) words="{" ".join(option.flag for option in known)}" ;;')
    return lines


def _bash(commands: dict[str, str], options: dict[str, list[Option]]) -> str:
    top = " ".join((*commands, "--help", "--version"))
    shells = " ".join(SHELLS)
    return "\n".join([
        "# Completion of polarfield for bash.",
        "_polarfield() {",
        '  local words="" command="${COMP_WORDS[1]}"',
        '  local current="${COMP_WORDS[COMP_CWORD]}" previous="${COMP_WORDS[COMP_CWORD-1]}"',
        '  [ "$previous" = "=" ] && previous="${COMP_WORDS[COMP_CWORD-2]}"',
        '  [ "$current" = "=" ] && { previous="${COMP_WORDS[COMP_CWORD-1]}"; current=""; }',
        f'  if [ "$COMP_CWORD" = 1 ]; then COMPREPLY=($(compgen -W "{top}" -- "$current")); return; fi',
        '  if [ "$command" = completion ]; then COMPREPLY=($(compgen -W "' + shells + '" -- "$current")); return; fi',
        '  case "$command $previous" in',
        *_words(commands, options),
        "  esac",
        "  # paths are what is left when no option begins so: bash's own default",
        '  [ "${current#-}" = "$current" ] && [ "${words#-}" != "$words" ] && words=""',
        '  COMPREPLY=($(compgen -W "$words" -- "$current"))',
        "}",
        "complete -o bashdefault -o default -F _polarfield polarfield",
        "",
    ])  # fmt: skip


def _zsh(commands: dict[str, str], options: dict[str, list[Option]]) -> str:
    lines = ["#compdef polarfield", "# Completion of polarfield for zsh.", "local -a commands"]
    lines += ["commands=(", *(f"  '{name}:{meaning}'" for name, meaning in commands.items()), ")"]
    lines += ["if (( CURRENT == 2 )); then", "  _describe command commands; _arguments '--help' '--version'; return", "fi"]
    lines += ["local name=$words[2]", "shift words; (( CURRENT-- ))", "case $name in"]
    for name, known in options.items():
        if name == "completion":
            lines.append(f"  completion) _values shell {' '.join(SHELLS)} ;;")
            continue
        specs = [f"'{o.flag}[{o.meaning}]{_zsh_value(o)}'" for o in known]
        lines += [f"  {name})", "    _arguments \\", *(f"      {spec} \\" for spec in specs), "      '*:folder:_files' ;;"]
    return "\n".join([*lines, "esac", ""])


def _zsh_value(option: Option) -> str:
    if not option.valued:
        return ""
    return f":value:({' '.join(option.choices)})" if option.choices else ":value:_files"


def _fish(commands: dict[str, str], options: dict[str, list[Option]]) -> str:
    lines = ["# Completion of polarfield for fish."]
    lines += [f"complete -c polarfield -n __fish_use_subcommand -a {n} -d '{meaning}'" for n, meaning in commands.items()]
    lines += ["complete -c polarfield -n __fish_use_subcommand -l version -d 'the version'"]
    lines.append(f"complete -c polarfield -f -n '__fish_seen_subcommand_from completion' -a '{' '.join(SHELLS)}'")
    for name, known in options.items():
        for o in known:
            values = f" -xa '{' '.join(o.choices)}'" if o.choices else " -r" * o.valued
            seen = f"'__fish_seen_subcommand_from {name}'"
            lines.append(f"complete -c polarfield -n {seen} -l {o.flag.lstrip('-')} -d '{o.meaning}'{values}")
    return "\n".join([*lines, ""])
