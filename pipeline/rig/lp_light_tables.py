"""Light tables of photometric stereo and RTI: NAME.lp (a count, then NAME x y z) and light_directions.txt (x y z a line)."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from pipeline.errors import UserError
from pipeline.formats.arrays import read_array
from pipeline.rig.light_table import LightTable
from pipeline.rig.lsx3_and_csv_light_tables import table_from_positions

DIRECTIONS, INTENSITIES, NAMES = "light_directions.txt", "light_intensities.txt", "filenames.txt"


def read_lp(path: Path) -> LightTable:
    """Read an RTI light-position file: a count, then NAME x y z of each light's picture.

    Args:
        path: the .lp.

    Returns:
        The lights with the names of their pictures.

    Raises:
        UserError: a line is malformed or the count wrong; names it.
    """
    lines = [line.strip() for line in path.read_text(encoding="utf-8-sig", errors="replace").splitlines()]
    lines = [line for line in lines if line]
    if not lines or not lines[0].split()[0].isdigit() or len(lines[0].split()) != 1:
        raise UserError(path, "does not begin with the count of its lights", "its lines must be: N, then NAME x y z")
    names, positions = [], []
    for number, line in enumerate(lines[1:], 2):
        cells = line.replace("\t", " ").rsplit(maxsplit=3)
        try:
            positions.append([float(cell) for cell in cells[1:]])
            if len(cells) != 4:
                raise ValueError
        except ValueError:
            raise UserError(path, f"line {number} is not NAME x y z: {line[:40]!r}", "mend that line") from None
        names.append(cells[0])
    if len(names) != int(lines[0]):
        raise UserError(path, f"counts {lines[0]} lights, but lists {len(names)}", "mend the count, or add the lines")
    return replace(table_from_positions(np.array(positions), path), names=tuple(names))


def read_position_array(path: Path) -> LightTable:
    """Read a NumPy array of light positions, as OpenIllumination has them (light_pos.npy).

    Args:
        path: the .npy, [N, 3].

    Returns:
        The lights, in the order of its rows.

    Raises:
        UserError: the file is damaged, or of another shape.
    """
    positions = read_array(path)
    if positions.ndim != 2 or positions.shape[1] != 3 or positions.dtype.kind not in "fiu" or not len(positions):
        fault = f"is no table of positions, but {positions.dtype} of {positions.shape}"
        raise UserError(path, fault, "give [lights, 3] numbers")
    return table_from_positions(positions.astype(np.float64), path)


def read_directions(path: Path) -> LightTable:
    """Read light_directions.txt as DiLiGenT has it, with light_intensities.txt and filenames.txt beside it where they are.

    Args:
        path: light_directions.txt.

    Returns:
        The lights; intensities per colour become a light's mean and its colour.

    Raises:
        UserError: a line is malformed, or the files do not fit each other; names it.
    """
    table = table_from_positions(_numbers(path, (3,)), path)
    intensities, names = path.with_name(INTENSITIES), path.with_name(NAMES)
    if intensities.is_file():
        channels = _numbers(intensities, (1, 3))
        values = channels.mean(1)
        if len(values) != len(table):
            raise UserError(intensities, f"has {len(values)} lines, {path.name} {len(table)}", "give each light one line")
        if channels.min() <= 0:
            raise UserError(intensities, "a light's intensity is not above 0", "take dead lights out of both tables")
        table = replace(table, intensity=values / values.mean())
        if channels.shape[1] == 3 and not np.allclose(channels, channels[:, :1]):
            table = replace(table, colour=channels / values[:, None])
    if names.is_file():
        listed = [line.strip() for line in names.read_text(errors="replace").splitlines() if line.strip()]
        if len(listed) != len(table):
            fault = f"names {len(listed)} pictures, {path.name} has {len(table)} lights"
            raise UserError(names, fault, "name each light's picture, in the order of the lights")
        table = replace(table, names=tuple(listed))
    return table


def _numbers(path: Path, widths: tuple[int, ...]) -> np.ndarray:
    rows: list[list[float]] = []
    for number, line in enumerate(path.read_text(encoding="utf-8-sig", errors="replace").splitlines(), 1):
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        try:
            rows.append([float(cell) for cell in line.replace(",", " ").split()])
        except ValueError:
            raise UserError(path, f"line {number} is not numbers: {line.strip()[:30]!r}", "mend that line") from None
        if len(rows[-1]) not in widths or len(rows[-1]) != len(rows[0]):
            raise UserError(path, f"line {number} has {len(rows[-1])} numbers", f"give {' or '.join(map(str, widths))} a line")
    if not rows:
        raise UserError(path, "is empty", "give one line a light")
    return np.array(rows)
