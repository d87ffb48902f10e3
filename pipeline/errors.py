"""The one exception for faults that a user can cause and mend."""

from __future__ import annotations

from pathlib import Path


class UserError(Exception):
    """A fault in a user's file or option; printed as one line, ends the command with status 2.

    `file` names what is at fault (a path, an option), `fault` says what is wrong with it, `remedy` what to do.
    """

    def __init__(self, file: str | Path, fault: str, remedy: str = "") -> None:
        self.file, self.fault, self.remedy = str(file), fault, remedy
        super().__init__(file, fault, remedy)

    def __str__(self) -> str:
        line = f"{self.file}: {self.fault}"
        return " ".join((f"{line}; {self.remedy}" if self.remedy else line).split())
