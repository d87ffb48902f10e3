"""Is a file one that a stage could have left? Asked of small tables before they are used, and of every input of a stage that
failed: a dataset, its manifests and digests with it, may have been written by anyone."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
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
from pipeline.rig.kept_samples import read_kept_samples
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


def inner_path(value: Any) -> str | None:
    """A path that leads nowhere but down."""
    down = isinstance(value, str) and len(value) < 4096 and "\0" not in value and not value.startswith("/")
    return None if down and ".." not in value.split("/") else "no path inside its folder"


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


def listed(form: Form) -> Form:
    """A list of these."""

    def fault(value: Any) -> str | None:
        if not isinstance(value, list):
            return "no list"
        return next((f"a list with {wrong} in it" for v in value if (wrong := form(v))), None)

    return fault


def vector(value: Any) -> str | None:
    """Three numbers."""
    return listed(number)(value) or (None if len(value) == 3 else "no three numbers")


def anything(value: Any) -> str | None:
    """Whatever it is: it is not used, or its reader refuses it."""
    return None


_VIEW = Table(
    {"width": count, "height": count, "camera": text},
    {name: maybe(number) for name in ("noise", "saturated_fraction", "condition")}
    | {name: maybe(inner_path) for name in ("file", "saturated", "alpha")}
    | {name: maybe(listed(anything)) for name in ("design", "covariance")},
)
_RIG_CAMERA = Table(
    {"width": count, "height": count, "camera": each(anything), "cross": listed(inner_path), "parallel": listed(inner_path)},
    {"mask": maybe(inner_path), "passes": one_of(("both", "cross", "parallel", "none"))},
)
_LIGHTS = Table(
    {"directions": listed(vector), "positions": listed(vector), "intensity": listed(number)},
    {"colour": maybe(listed(vector)), "solid_angle": maybe(listed(number))},
)
FORMS: dict[str, Form] = {
    "frames.json": Table({"views": each(_VIEW)}, {"polarisation": text, "parts": maybe(each(text))}),
    "olat.json": Table({"cameras": each(_RIG_CAMERA), "lights": _LIGHTS}, {}),
    files.MASKS: Table({"views": each(maybe(Table({}, {"coverage": maybe(number)})))}, {}),
    files.POLARISERS: each(Table({}, {"angle_deg": maybe(number)})),
    files.LIGHTING: Table(
        {},
        {
            "up": one_of(UP_AXES), "fresnel": one_of(FRESNELS), "lobe": one_of(DISTRIBUTIONS), "occlusion": flag,
            "indirect": one_of(get_args(Indirect)),
        },
    ),
    files.FITTED_LOBE: Table({"lobe": one_of(LOBES)}, {}),
    "asset.json": Table({}, {"unit_m": maybe(number), "texture_size": maybe(listed(count))}),
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
    wrong = FORMS.get(path.name, anything)(value)
    return f"is {wrong}" if wrong else None


def sizes_of(tables: Iterable[Path]) -> dict[str, tuple[int, int]]:
    """Read the size of every view's, or light-stage camera's, pictures from what stages left.

    Args:
        tables: files of any kind; those that are frames.json or olat.json and have their form are read.

    Returns:
        Width, height in pixels by VIEW or camera.
    """
    entries: dict[str, Any] = {}
    for path in tables:
        key = {"frames.json": "views", "olat.json": "cameras"}.get(path.name)
        if key is not None and fault_of_table(path) is None:
            entries |= read_json(path)[key]
    return {name: (entry["width"], entry["height"]) for name, entry in entries.items()}


def fault_of_result(path: Path, sizes: Mapping[str, tuple[int, int]]) -> str | None:
    """Say what is wrong with any file that a stage left, reading all of it.

    Args:
        path: the file.
        sizes: of `sizes_of`.

    Returns:
        Words that follow the file's name; None where it can be read, all its numbers are finite, and it is as large as its
        view.
    """
    suffix = path.suffix.lower()
    if suffix == ".json":
        return fault_of_table(path)
    try:
        if suffix in (".exr", ".hdr", ".png"):
            image = read_image(path)
            if not np.isfinite(image).all():
                return "holds pixels that are no numbers"
            want, have = _view_size(path, sizes), image.shape[1::-1]
            return None if want is None or want == have else f"is {have[0]}x{have[1]}, its view {want[0]}x{want[1]}"
        if suffix == ".ply":
            return _fault_of_ply(Ply(path))
        if path.name == files.KEPT_SAMPLES:
            read_kept_samples(path)
    except UserError as error:
        return error.fault
    return None


def _view_size(path: Path, sizes: Mapping[str, tuple[int, int]]) -> tuple[int, int] | None:
    """The size that a picture named after a view, or in a camera's folder, should have."""
    if {files.TURNTABLE, files.PATH, files.ASSET} & {*path.parts}:
        return None
    names = (path.stem, path.stem.removesuffix(files.SUMMED).removesuffix(files.ERROR), path.parent.name)
    return next((sizes[name] for name in names if name in sizes), None)


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
