"""Is a file one that a stage could have left? Asked of small tables before they are used, and of every input of a stage that
failed: a dataset, its manifests and digests with it, may have been written by anyone."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, get_args

import numpy as np

from pipeline.errors import UserError
from pipeline.formats import dataset_files as files
from pipeline.formats.images import read_image
from pipeline.formats.json_file import read_json
from pipeline.formats.ply import Ply
from pipeline.geometry.world import UP_AXES
from pipeline.optics.model_names import DISTRIBUTIONS, FRESNELS, Indirect
from pipeline.rig.lobe_names import LOBES

Form = Callable[[Any], str | None]
"""Says of a JSON value what it is not; None where it is that."""


def number(value: Any) -> str | None:
    """A number; what was never measured may be infinite or none."""
    whole = type(value) is int and abs(value) < 1 << 63
    return None if whole or isinstance(value, float) else "no number"


def text(value: Any) -> str | None:
    """A text."""
    return None if isinstance(value, str) and len(value) < 1 << 16 else "no text"


def flag(value: Any) -> str | None:
    """True or false."""
    return None if isinstance(value, bool) else "neither true nor false"


def count(value: Any) -> str | None:
    """A number of pixels."""
    return None if type(value) is int and 0 < value < 1 << 20 else "no number of pixels"


def maybe(form: Form) -> Form:
    """This, or null."""
    return lambda value: None if value is None else form(value)


def one_of(names: Any) -> Form:
    """One of these texts."""
    return lambda value: None if isinstance(value, str) and value in names else f"none of {', '.join(names)}"


def each(form: Form) -> Form:
    """A table whose every value is this."""

    def fault(value: Any) -> str | None:
        if not isinstance(value, Mapping):
            return "no table"
        return next((f"{name[:40]!r} is {wrong}" for name, v in value.items() if (wrong := form(v))), None)

    return fault


@dataclass(frozen=True)
class Table:
    """A table with these keys at least: those of `needed` must be there, those of `known` are this where they are there."""

    needed: Mapping[str, Form]
    known: Mapping[str, Form]

    def __call__(self, value: Any) -> str | None:
        """What it is not."""
        if not isinstance(value, Mapping):
            return "no table"
        for name, form in {**self.known, **self.needed}.items():
            if name not in value:
                if name in self.needed:
                    return f"without {name}"
            elif wrong := form(value[name]):
                return f"one whose {name} is {wrong}"
        return None


def _seen(value: Any) -> str | None:
    return None if isinstance(value, list) else "no list"


_VIEW = Table(
    {"width": count, "height": count, "camera": text},
    {name: maybe(number) for name in ("noise", "saturated_fraction", "condition")}
    | {name: maybe(text) for name in ("file", "saturated", "alpha")}
    | {name: maybe(_seen) for name in ("design", "covariance")},
)
_RIG_CAMERA = Table(
    {"width": count, "height": count, "camera": each(lambda value: None), "cross": _seen, "parallel": _seen},
    {"mask": maybe(text), "passes": text},
)
FORMS: dict[str, Form] = {
    "frames.json": Table({"views": each(_VIEW)}, {"polarisation": text, "parts": maybe(each(text))}),
    "olat.json": Table({"cameras": each(_RIG_CAMERA), "lights": each(lambda value: None)}, {}),
    files.MASKS: Table({"views": each(maybe(Table({}, {"coverage": maybe(number)})))}, {}),
    files.POLARISERS: each(Table({}, {"angle_deg": maybe(number)})),
    files.LIGHTING: Table(
        {},
        {
            "up": one_of(UP_AXES), "fresnel": one_of(FRESNELS), "lobe": one_of(DISTRIBUTIONS), "occlusion": flag,
            "indirect": one_of(get_args(Indirect)),
        },
    ),
    files.FITTED_LOBE: Table({}, {"lobe": one_of(LOBES)}),
    "asset.json": Table({}, {"unit_m": maybe(number), "texture_size": maybe(_seen)}),
    "metrics.json": Table({}, {}),
}  # fmt: skip
"""Of the tables that later stages and commands read, by name."""


def fault_of_table(path: Path) -> str | None:
    """Say what is wrong with a JSON table of ours.

    Args:
        path: the file; one of a name that is not in `FORMS` is any JSON.

    Returns:
        Words that follow the file's name; None where it has its form.
    """
    try:
        value = read_json(path)
    except UserError as error:
        return error.fault
    wrong = FORMS.get(path.name, lambda value: None)(value)
    return f"is {wrong}" if wrong else None


def fault_of_result(path: Path) -> str | None:
    """Say what is wrong with any file that a stage left, reading all of it.

    Args:
        path: the file.

    Returns:
        Words that follow the file's name; None where it can be read and all its numbers are finite.
    """
    suffix = path.suffix.lower()
    if suffix == ".json":
        return fault_of_table(path)
    try:
        if suffix in (".exr", ".hdr", ".png"):
            return None if np.isfinite(read_image(path)).all() else "holds pixels that are no numbers"
        if suffix == ".ply":
            return _fault_of_ply(Ply(path))
    except UserError as error:
        return error.fault
    return None


def _fault_of_ply(ply: Ply) -> str | None:
    points = ply.vertices()
    if not len(points):
        return "holds nothing"
    columns = ply.elements["vertex"].columns.values()
    if not all(np.isfinite(c).all() and math.isfinite(float(np.ptp(c.astype(np.float64)))) for c in columns):
        return "holds numbers that are not finite"
    if "face" in ply.elements and not len(ply.triangles()):
        return "holds no triangle"
    return None
