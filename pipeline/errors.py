"""The one exception for faults that a user can cause and mend."""

from __future__ import annotations

import difflib
from collections.abc import Iterable
from pathlib import Path

FEW = 8  # names that fit a line beside a fault
LONGEST = 400  # characters of a word that a person reads
LONGEST_LINE = 1500  # of a whole line: two paths, what is wrong with them, and what to do


class UserError(Exception):
    """A fault in a user's file or option; printed as one line, ends the command with status 2.

    `file` names what is at fault (a path, an option), `fault` says what is wrong with it, `remedy` what to do.
    """

    status = 2

    def __init__(self, file: str | Path, fault: str, remedy: str = "") -> None:
        """Say what is at fault, what is wrong with it, and what to do.

        Args:
            file: a path or an option.
            fault: follows it in the line.
            remedy: follows the fault; "" where there is none.
        """
        self.file, self.fault, self.remedy = str(file), fault, remedy
        super().__init__(file, fault, remedy)

    def __str__(self) -> str:
        line = f"{self.file}: {self.fault}"
        return one_line(f"{line}; {self.remedy}" if self.remedy else line)


def one_line(text: str) -> str:
    """Put a text into one line, in which no word is longer than a person reads (a path of 5000 characters, a garbled value).

    Args:
        text: of any length.

    Returns:
        The line; long words, and a long line, lose their middle; what would steer a terminal is written out (an escape as
        \\x1b).
    """
    text = "".join(c if c.isprintable() or c.isspace() else c.encode("unicode_escape").decode() for c in text)
    return _shortened(" ".join(_shortened(word, LONGEST) for word in text.split()), LONGEST_LINE)


def _shortened(text: str, most: int) -> str:
    return text if len(text) <= most else f"{text[: most // 2]}...{text[-most // 2 :]}"


def line_of(error: Exception) -> str:
    """Write a fault of the user's, of the disk or of the memory as one line.

    Args:
        error: that was caught.

    Returns:
        The line.
    """
    if isinstance(error, OSError) and error.strerror:
        name = error.filename if isinstance(error.filename, str | Path) else "polarfield"
        return one_line(f"{name}: {error.strerror}")
    if isinstance(error, MemoryError):
        return "there is not enough memory; give it to a machine with more, or smaller images"
    return str(error)


def nearest(name: str, valid: Iterable[str]) -> str:
    """Write a remedy for a misspelt name.

    Args:
        name: as given.
        valid: names that there are.

    Returns:
        The valid one nearest to it, and all of them where they are few or none is near.
    """
    names = {n.lower().strip("-").replace("-", "_"): n for n in valid}
    near = difflib.get_close_matches(name.lower().strip("-").replace("-", "_"), names, 1)
    listed = f"known: {', '.join(names.values())}" if names else "there is none to give"
    if not near:
        return listed
    return f"did you mean {names[near[0]]}?" + (f" {listed}" if len(names) <= FEW else "")
