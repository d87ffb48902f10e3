"""One row of the table of stability: what was tried, its figures, and whether it is sound."""

from __future__ import annotations

from dataclasses import dataclass, field


@dataclass(frozen=True)
class Row:
    """A case of a part; figures by name; worst: the input that gave the worst figure; why: what is wrong, if not sound."""

    part: str
    name: str
    setting: str
    figures: dict[str, float | int | str]
    sound: bool
    worst: str = ""
    why: str = ""
    warnings: list[str] = field(default_factory=list)
