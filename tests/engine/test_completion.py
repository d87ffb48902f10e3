"""What shells offer to complete, and what the help shows."""

from __future__ import annotations

import shlex
import shutil
import subprocess

import pytest

from pipeline.engine.arguments import COMMANDS, command_parser, parse
from pipeline.engine.completion import SHELLS, script
from pipeline.engine.examples import EXAMPLES
from pipeline.engine.plan import load_stages
from pipeline.errors import UserError
from stages import FORMATS, STAGES

PARSER = command_parser(load_stages(STAGES), FORMATS)


def offered(*words: str) -> set[str]:
    """What bash offers for the last of the words."""
    line = " ".join(f"'{w}'" for w in words)
    call = f"{script('bash', PARSER)}\nCOMP_WORDS=({line}); COMP_CWORD={len(words) - 1}; _polarfield; echo ${{COMPREPLY[@]}}"
    done = subprocess.run(["bash", "-c", call], capture_output=True, text=True, check=True)
    assert done.stderr == ""
    return set(done.stdout.split())


def test_bash_completes_commands_options_and_values():
    assert offered("polarfield", "me") == {"mesh", "metrics"}
    assert {*COMMANDS, *STAGES} <= offered("polarfield", "")
    assert offered("polarfield", "train", "--weight-m") == {"--weight-mask"}
    assert offered("polarfield", "train", "--fresnel", "") == {"exact", "schlick"}
    assert offered("polarfield", "train", "--fresnel", "=", "e") == {"exact"}
    assert offered("polarfield", "mesh", "--textures", "t") == {"true"}
    assert offered("polarfield", "export", "--to", "g") == {"glb"}
    assert offered("polarfield", "completion", "") == set(SHELLS)
    assert offered("polarfield", "export", "captures/va") == set()  # a path: bash's own


@pytest.mark.parametrize("shell", SHELLS)
def test_every_shell_is_told_every_command_and_option(shell):
    text = script(shell, PARSER)
    assert all(name in text for name in (*COMMANDS, *STAGES))
    assert "weight-polarisation" in text and "usdz" in text and "--alone" not in text
    if program := shutil.which(shell):
        assert subprocess.run([program, "-n"], input=text, text=True, capture_output=True).stderr == ""


def test_the_help_of_every_command_ends_with_examples_that_parse():
    assert set(EXAMPLES) - {""} <= {*COMMANDS, *STAGES}
    commands = next(action for action in PARSER._actions if action.dest == "command").choices
    assert set(commands) == {*COMMANDS, *STAGES}
    for parser in (PARSER, *commands.values()):
        shown = parser.format_help().partition("examples:\n")[2].splitlines()
        assert shown and all(line.startswith("  ") for line in shown), parser.prog
    for name, calls in EXAMPLES.items():
        for call in () if name == "completion" else calls:
            given = shlex.split(call)[1:]
            if "--help" not in given:
                assert PARSER.parse_args(given).command == (name or given[0])


def test_the_version_is_said(capsys):
    with pytest.raises(SystemExit) as end:
        parse({}, ["--version"])
    assert end.value.code == 0 and capsys.readouterr().out.startswith("polarfield ")
    with pytest.raises(UserError, match="csh"):
        parse({}, ["completion", "csh"])
