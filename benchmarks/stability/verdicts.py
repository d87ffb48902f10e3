"""One row of the table of stability: what was tried, its figures, whether it is sound, and which commit ran it."""

from __future__ import annotations

from dataclasses import dataclass, field


@dataclass(frozen=True)
class Row:
    """A case of a part; figures by name; worst: the input that gave the worst figure; why: what is wrong, if not sound; commit:
    of the program that was tried."""

    part: str
    name: str
    setting: str
    figures: dict[str, float | int | str]
    sound: bool
    worst: str = ""
    why: str = ""
    warnings: list[str] = field(default_factory=list)
    commit: str = ""
