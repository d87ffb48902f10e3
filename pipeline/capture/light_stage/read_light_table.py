"""The light table of a capture: lights.csv, the LSX3 stage's two files, an .lp file or light_directions.txt."""

from __future__ import annotations

from pathlib import Path

from pipeline.capture.config import CaptureConfig
from pipeline.capture.light_stage.folders import NOT_OF_A_STAGE
from pipeline.capture.naming.files import subfolders
from pipeline.errors import UserError
from pipeline.rig.light_table import LightTable
from pipeline.rig.lsx3_and_csv_light_tables import LSX3_POSITIONS, LSX3_SPIRAL, read_lights_csv, read_lsx3

CSV, DIRECTIONS = "lights.csv", "light_directions.txt"
SIGNS = (CSV, DIRECTIONS, "light_positions.txt", "LSX3_light_positions.txt", "LSX3_light_z_spiral.txt", "light_intensities.txt")


def table_beside(root: Path) -> Path | None:
    """A light table among the files of a capture, or of a folder below it, by its name; None without one."""
    for folder in (root, *subfolders(root, NOT_OF_A_STAGE)):
        lower = {p.name.lower(): p for p in sorted(folder.iterdir()) if p.is_file() and not p.name.startswith(".")}
        found = next((lower[name.lower()] for name in SIGNS if name.lower() in lower), None)
        found = found or next((p for name, p in lower.items() if name.endswith(".lp") and _is_lp(p)), None)
        if found is not None:
            return found
    return None


def _is_lp(path: Path) -> bool:
    """Whether a .lp file begins as RTI's do, with a count alone on its line (linear programs do not)."""
    with path.open("rb") as stream:
        return stream.readline(200).lstrip(b"\xef\xbb\xbf").strip().isdigit()


def light_table_file(root: Path, config: CaptureConfig) -> Path | None:
    """Find the file that says where a capture's lights are.

    Args:
        root: the capture's folder.
        config: its capture.toml, which may name the file.

    Returns:
        The file (of LSX3's two, the positions); None where there is none.
    """
    if config.olat.lights is not None:
        return root / config.olat.lights
    path = next((p for p in (root / CSV, *(q for q in root.iterdir() if q.name.lower() == CSV)) if p.is_file()), None)
    if path is None and any((root / name).is_file() for name in (LSX3_POSITIONS, LSX3_SPIRAL)):
        return root / LSX3_POSITIONS
    return path or table_beside(root)


def read_light_table(root: Path, config: CaptureConfig) -> tuple[LightTable, list[Path]]:
    """The lights, and the files that they were read from, the last of them named in errors. Raises UserError."""
    from pipeline.rig.lp_light_tables import INTENSITIES, NAMES, read_directions, read_lp, read_position_array

    path = light_table_file(root, config)
    if path is None:
        raise UserError(root, "the frames have no light table", f"add lights.csv, or {LSX3_POSITIONS} and {LSX3_SPIRAL}")
    if path == root / LSX3_POSITIONS:
        return read_lsx3(root), [path, root / LSX3_SPIRAL]
    if path.suffix.lower() == ".lp" and path.is_file():
        return read_lp(path), [path]
    if path.name.lower() == DIRECTIONS and path.is_file():
        beside = [p for p in (path.with_name(INTENSITIES), path.with_name(NAMES)) if p.is_file()]
        return read_directions(path), [*beside, path]
    if path.suffix.lower() == ".npy" and path.is_file():
        return read_position_array(path), [path]
    return read_lights_csv(path), [path]
