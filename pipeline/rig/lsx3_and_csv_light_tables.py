"""Light tables on disk: the LSX3 stage's two text files, and a `lights.csv` for any other rig (`lp_light_tables`: .lp lists).

Light k is always the k-th frame of a pass. Directions point from the stage's centre to the light, in the world of the cameras.
"""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import UserError
from pipeline.rig.light_table import LightTable

LSX3_POSITIONS = "LSX3_light_positions.txt"
LSX3_SPIRAL = "LSX3_light_z_spiral.txt"
COLOURS = ("red", "green", "blue")
WORLD_FROM_TABLE = np.array([-1.0, 1.0, -1.0])  # the published table is turned 180 degrees about y against the cameras


def read_lsx3(root: Path) -> LightTable:
    """Read the LSX3 rig: the spiral's k-th entry names the row (from 1) of light k; positions are turned 180 degrees about y.

    Args:
        root: the folder of the two tables.

    Returns:
        The lights, in the order of the frames.

    Raises:
        UserError: a table is missing or malformed, or its length does not fit the other's.
    """
    positions = _numbers(root / LSX3_POSITIONS, 3)
    spiral = _numbers(root / LSX3_SPIRAL, 1)[:, 0]
    rows = spiral.astype(int)
    path = root / LSX3_SPIRAL
    if np.any(rows != spiral) or rows.min() < 1 or rows.max() > len(positions):
        bad = spiral[(rows != spiral) | (rows < 1) | (rows > len(positions))][0]
        raise UserError(path, f"names row {bad:g} of a table with rows 1..{len(positions)}", f"mend it or {LSX3_POSITIONS}")
    if len(rows) != len(positions):
        raise UserError(
            path, f"has {len(rows)} entries for the {len(positions)} rows of {LSX3_POSITIONS}", "use the tables as published"
        )
    if len(np.unique(rows)) != len(rows):
        values, counts = np.unique(rows, return_counts=True)
        raise UserError(path, f"names row {values[counts > 1][0]} twice", "use the table as published")
    return table_from_positions(positions[rows - 1] * WORLD_FROM_TABLE, root / LSX3_POSITIONS)


def read_lights_csv(path: Path) -> LightTable:
    """Read a rig from a lights.csv: `index, x, y, z[, intensity][, red, green, blue][, solid_angle]`.

    A light that did not fire is left out: its index then is missing, and its frame is not used.

    Args:
        path: the file; positions in world units, or directions.

    Returns:
        The lights, ordered by index.

    Raises:
        UserError: the file is missing, a column, cell or value is wrong, or an index stands twice; names the line.
    """
    if not path.is_file():
        raise UserError(path, "no such light table", "add it, or name the right file as `lights` under [olat] in capture.toml")
    with path.open(newline="", encoding="utf-8-sig", errors="replace") as stream:
        rows = [row for row in csv.reader(stream) if row and not row[0].lstrip().startswith("#")]
    names = [cell.strip().lower() for cell in rows[0]] if rows else []
    wanted = {"index", "x", "y", "z"}
    if not wanted <= set(names):
        missing = ", ".join(sorted(wanted - set(names)))
        why = _why_no_columns(names)
        raise UserError(path, f"has no column {missing}{why}", "its first line must be index,x,y,z[,intensity][,solid_angle]")
    values: dict[str, list[float]] = {name: [] for name in names}
    for number, row in enumerate(rows[1:], 2):
        if len(row) != len(names):
            raise UserError(path, f"line {number} has {len(row)} cells, the first line {len(names)}", "mend that line")
        for name, cell in zip(names, row):
            try:
                values[name].append(float(cell))
            except ValueError:
                raise UserError(path, f"line {number}: {name} = {cell.strip()!r} is not a number", "mend that line") from None
    index = np.array(values["index"])
    if not len(index):
        raise UserError(path, "lists no light", "add one line per light")
    if len(np.unique(index)) != len(index):
        repeated = index[np.argsort(index)][:-1][np.diff(np.sort(index)) == 0][0]
        raise UserError(path, f"lists index {repeated:g} twice", "give every light its own index")
    order = np.argsort(index)
    column = {name: np.array(cells)[order] for name, cells in values.items()}
    table = table_from_positions(np.stack([column["x"], column["y"], column["z"]], -1), path)
    intensity, area = column.get("intensity", table.intensity), column.get("solid_angle")
    intensity, colour = _coloured(intensity, column, path)
    if not np.all(np.isfinite(intensity)) or np.any(intensity <= 0):
        raise UserError(path, "a light's intensity is not above 0", "take lights that did not fire out of the table")
    if area is not None and (not np.all(np.isfinite(area)) or np.any(area < 0)):
        raise UserError(path, "a solid angle is negative or not finite", "mend it, or drop the column to have it computed")
    numbers = column["index"]
    if not np.all(np.isfinite(numbers)) or np.any(numbers != np.round(numbers)) or np.any(numbers < 0):
        bad = numbers[~(np.isfinite(numbers) & (numbers == np.round(numbers)) & (numbers >= 0))][0]
        raise UserError(path, f"index {bad:g} is no whole number from 0", "number the lights as their frames are")
    return LightTable(table.directions, table.positions, intensity, area, numbers.astype(np.int64), colour=colour)


def _why_no_columns(names: list[str]) -> str:
    """What a first line without the columns' names looks like, in words."""
    line = ",".join(names)
    if "\0" in line:
        return " (it is UTF-16 text: save it as UTF-8)"
    if ";" in line or "\t" in line:
        return " (its cells are parted by semicolons or tabs: save it with commas, and points in numbers)"
    numbers = [name for name in names if name.replace(".", "").replace("-", "").replace("e", "").isdigit()]
    return " (it begins with numbers)" if names and len(numbers) == len(names) else f" (it has {line})" if names else ""


def _coloured(
    intensity: NDArray[np.float64], column: dict[str, NDArray[np.float64]], path: Path
) -> tuple[NDArray[np.float64], NDArray[np.float64] | None]:
    """Intensities [N] and, where the table has them, colours [N, 3] of mean 1. Raises UserError."""
    if not set(COLOURS) <= set(column):
        return intensity, None
    colour = np.stack([column[c] for c in COLOURS], -1)
    if not np.all(np.isfinite(colour)) or np.any(colour <= 0):
        raise UserError(path, "a light's colour is not above 0", "take lights that did not fire out of the table")
    return intensity * colour.mean(1), colour / colour.mean(1, keepdims=True)


def table_from_positions(positions: NDArray[np.float64], path: Path | str = "lights") -> LightTable:
    """A rig of equal lights at `positions` [N, 3] (world units, or directions). Raises UserError on a light at the origin."""
    length = np.linalg.norm(positions, axis=1)
    if not np.all(np.isfinite(length)) or np.any(length == 0):
        bad = int(np.argmax(~np.isfinite(length) | (length == 0)))
        raise UserError(path, f"light {bad} lies at {positions[bad].tolist()}, which has no direction", "mend that line")
    return LightTable(positions / length[:, None], positions, np.ones(len(positions)), None)


def _numbers(path: Path, columns: int) -> NDArray[np.float64]:
    """A whitespace-separated table float64 [N, columns]."""
    if not path.is_file():
        raise UserError(path, "no such light table", f"{LSX3_POSITIONS} and {LSX3_SPIRAL} come together; or use lights.csv")
    rows = []
    for number, line in enumerate(path.read_text(errors="replace").splitlines(), 1):
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        try:
            cells = [float(cell) for cell in line.replace(",", " ").split()]
        except ValueError:
            raise UserError(
                path, f"line {number} is not numbers: {line.strip()[:30]!r}", "use the table as published"
            ) from None
        if len(cells) != columns:
            raise UserError(path, f"line {number} has {len(cells)} numbers, not {columns}", "use the table as published")
        rows.append(cells)
    if not rows:
        raise UserError(path, "is empty", "use the table as published")
    return np.array(rows)
