"""Folders of a light stage: camNN/cross and camNN/parallel, whatever their case, separators and usual other names."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from pathlib import Path

from pipeline.capture.naming.files import ASIDE, OLAT, subfolders
from pipeline.errors import UserError

CAMERA = re.compile(r"^(?:cam|camera|c)[\s_.\-]*0*(?P<number>\d+)$", re.IGNORECASE)
PASSES = ("cross", "parallel")
ENDS = ("", "pol", "polar", "polarised", "polarized", "polarisation", "polarization", "polariser", "polarizer", "pass")
WORDS = {
    "cross": {f"{word}{end}" for word in ("cross", "crossed", "perpendicular", "perp") for end in ENDS} | {"xpol", "xp"},
    "parallel": {f"{word}{end}" for word in ("parallel", "par", "para", "uncrossed") for end in ENDS}
    | {"ppol", "pp", "copol", "copolarised", "copolarized"},
}
"""Names of the two passes, lower case, letters alone."""
DEEPEST = 3
NOT_OF_A_STAGE = ASIDE - {OLAT}
"""Folders in which no part of a light stage lies."""


@dataclass
class CameraFolders:
    """One camera's folders: of each pass, and the one that holds its mask and truth."""

    name: str
    home: Path
    passes: dict[str, Path] = field(default_factory=dict)
    plain: bool = True


def camera_number(name: str) -> int | None:
    """The number of a camera's folder or file (cam00, Cam_0, camera-00, C001), or None."""
    match = CAMERA.match(name)
    return int(match["number"]) if match else None


def pass_of(name: str) -> str | None:
    """ "cross" or "parallel" where a folder's name says so."""
    letters = re.sub(r"[^a-z]", "", name.lower())
    return next((key for key, words in WORDS.items() if letters in words), None)


def stage_folders(root: Path) -> dict[str, CameraFolders]:
    """Cameras by name (camNN) whose folders hold passes, or passes that hold cameras. Raises UserError on doubles.

    Passes without a camera's folder belong to one camera, cam00. `plain` is False where only the passes' names say that
    this is a light stage: then a light table or camera files have to agree.
    """
    cameras: dict[str, CameraFolders] = {}
    for folder in sorted(_folders(root, DEEPEST)):
        which = pass_of(folder.name)
        if which is None:
            continue
        inside = [p for p in sorted(folder.iterdir()) if p.is_dir() and camera_number(p.name) is not None]
        if camera_number(folder.parent.name) is not None and folder.parent != root:
            _add(cameras, folder.parent.name, folder.parent, which, folder, folder.parent.parent == root)
        elif inside:
            for place in inside:
                _add(cameras, place.name, place, which, place, False)
        else:
            _add(cameras, "cam00", folder.parent, which, folder, False)
    return cameras


def _folders(root: Path, depth: int) -> list[Path]:
    if depth == 0:
        return []
    here = subfolders(root, NOT_OF_A_STAGE)
    return [*here, *(q for p in here for q in _folders(p, depth - 1))]


def _add(cameras: dict[str, CameraFolders], label: str, home: Path, which: str, folder: Path, plain: bool) -> None:
    name = label if re.fullmatch(r"cam\d+", label) else f"cam{camera_number(label) or 0:02d}"
    camera = cameras.setdefault(name, CameraFolders(name, home, plain=plain))
    if which in camera.passes:
        raise UserError(folder, f"is the {which} pass of {name}, and so is {camera.passes[which]}", "keep one of the two")
    camera.passes[which] = folder


def home_of(root: Path, name: str) -> Path:
    """Find the folder of a light-stage camera that holds its mask and truth.

    Args:
        root: the capture's folder.
        name: the camera's, "camNN".

    Returns:
        The folder, whatever its spelling; root/NAME where none is found.
    """
    if (root / name).is_dir():
        return root / name
    found = stage_folders(root).get(name) if root.is_dir() else None
    return found.home if found is not None else root / name


def camera_file(root: Path, name: str) -> Path:
    """The LSX3 camera file of a camera: cameras/cameraNN.txt, or one of that number under another usual name."""
    number = camera_number(name) or 0
    usual = root / "cameras" / f"camera{number:02d}.txt"
    if usual.is_file():
        return usual
    places = [p for p in root.iterdir() if p.is_dir() and p.name.lower() in ("cameras", "camera", "calibration", "calib")]
    files = [p for place in sorted(places) for p in sorted(place.glob("*.txt")) if not p.name.startswith(".")]
    return next((p for p in files if camera_number(p.stem) == number), usual)
