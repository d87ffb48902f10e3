"""Agisoft Metashape's cameras.xml (File > Export > Export Cameras): sensors, poses, and the place of each component."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pipeline.capture.camera_files.table import CameraTable, Size
from pipeline.capture.naming.files import count, some
from pipeline.errors import UserError
from pipeline.geometry.cameras import Camera
from pipeline.geometry.lens_models import PINHOLE

SEEN_PX = 0.05
"""A lens term that moves no pixel of the frame by more is none."""


@dataclass(frozen=True)
class _Sensor:
    size: Size
    focal: tuple[float, float]
    centre: tuple[float, float]
    distortion: tuple[float, ...]
    model: str = PINHOLE


def find(folders: list[Path]) -> Path | None:
    """A Metashape camera file in one of the folders."""
    for folder in folders:
        for path in sorted(folder.glob("*.xml")):
            if not path.name.startswith(".") and _looks_right(path):
                return path
    return None


def _looks_right(path: Path) -> bool:
    with path.open("rb") as stream:
        head = stream.read(4096)
    return b"<document" in head and (b"<chunk" in head or b"<sensors" in head)


def read(path: Path) -> CameraTable:
    """Cameras in the world of the chunk's (or component's) transform, else in the chunk's own. Raises UserError.

    A camera's `transform` takes camera axes (x right, y down, z ahead) to the chunk; f, cx, cy (from the middle of the
    frame), b1, k1 k2 k3 p1 p2 are Metashape's, whose p1 and p2 stand the other way round than OpenCV's.
    """
    try:
        chunks = ElementTree.parse(path).getroot().findall("chunk")
        if not chunks:
            raise ValueError("no <chunk>")
        found = [_aligned(chunk) for chunk in chunks]
        chosen = max(range(len(chunks)), key=lambda k: len(found[k][0]))
        cameras, unplaced = found[chosen]
        sensors = {s.get("id", ""): s for s in chunks[chosen].iter("sensor")}
        lenses = {key: _sensor(sensors[key], path) for key in {c.sensor for c in cameras}}
    except (ElementTree.ParseError, ValueError, KeyError) as error:
        fault = f"is no camera file that Metashape exports ({type(error).__name__}: {error})"
        raise UserError(path, fault, "export it again, or export a COLMAP model") from None
    if not cameras:
        raise UserError(path, "holds no aligned camera", "align the photographs, or move the file away")
    kept = [c for c in cameras if c.world == Counter(c.world for c in cameras).most_common(1)[0][0]]

    def camera(index: int, size: Size) -> Camera:
        lens = lenses[kept[index].sensor]
        return Camera(*lens.size, *lens.focal, *lens.centre, kept[index].pose, lens.distortion, lens=lens.model)

    warnings = _left_out(path, len(chunks), [c.label for c in cameras if c not in kept], unplaced)
    return CameraTable(path, "Metashape", tuple(c.label for c in kept), len(kept), camera, (path,), warnings=tuple(warnings))


@dataclass(frozen=True, eq=False)
class _Aligned:
    """A photograph's label, camera from world [4, 4], sensor, and the component whose own world that is ("": the chunk's)."""

    label: str
    pose: NDArray[np.float64]
    sensor: str
    world: str


def _aligned(chunk: ElementTree.Element) -> tuple[list[_Aligned], list[str]]:
    """The cameras of a chunk, and the labels of those that were not aligned. Raises ValueError."""
    places = {c.get("id", ""): _place(c.find("transform")) for c in chunk.iter("component")}
    world = _place(chunk.find("transform"))
    cameras, unplaced = [], []
    for element in chunk.iter("camera"):
        label, component = element.get("label", ""), element.get("component_id", "")
        transform = element.find("transform")
        if transform is None or not (transform.text or "").strip():
            unplaced.append(label)
            continue
        place = world if world is not None else places.get(component)
        pose = _world_to_camera(_numbers(transform, 16).reshape(4, 4), place)
        cameras.append(_Aligned(label, pose, element.get("sensor_id", ""), component if place is None else ""))
    return cameras, unplaced


def _left_out(path: Path, chunks: int, apart: list[str], unplaced: list[str]) -> list[str]:
    lines = []
    if unplaced:
        unaligned = f"{count(unplaced, 'photograph')} not aligned by Metashape ({some(unplaced)})"
        lines.append(f"{path}: {unaligned}; left out: check their alignment there")
    if apart:
        other = f"{count(apart, 'photograph')} of other components ({some(apart)})"
        lines.append(f"{path}: {other}, each of which has a world of its own; left out: merge the components in Metashape")
    if chunks > 1:
        lines.append(f"{path}: the largest of its {chunks} chunks is used: check that it is the right one, or export it alone")
    return lines


def _numbers(element: ElementTree.Element, length: int) -> NDArray[np.float64]:
    values = np.array([float(cell) for cell in (element.text or "").split()])
    if len(values) != length or not np.isfinite(values).all():
        raise ValueError(f"<{element.tag}> holds no {length} numbers")
    return values


def _place(transform: ElementTree.Element | None) -> NDArray[np.float64] | None:
    """World from chunk [4, 4] (with its scale) of a <transform> of rotation, translation and scale; None without one."""
    if transform is None or transform.find("rotation") is None:
        return None
    out = np.eye(4)
    scale = transform.find("scale")
    factor = _numbers(scale, 1)[0] if scale is not None else 1.0
    rotation, translation = transform.find("rotation"), transform.find("translation")
    assert rotation is not None
    out[:3, :3] = factor * _numbers(rotation, 9).reshape(3, 3)
    out[:3, 3] = _numbers(translation, 3) if translation is not None else 0
    return out


def _world_to_camera(pose: NDArray[np.float64], place: NDArray[np.float64] | None) -> NDArray[np.float64]:
    if place is not None:
        scale = np.cbrt(np.linalg.det(place[:3, :3]))
        if not scale > 0:
            raise ValueError("a <transform> mirrors or has no extent")
        turned = np.eye(4)
        turned[:3, :3] = place[:3, :3] @ pose[:3, :3] / scale
        turned[:3, 3] = place[:3, :3] @ pose[:3, 3] + place[:3, 3]
        pose = turned
    if np.linalg.matrix_rank(pose) < 4:
        raise ValueError("a camera's <transform> is no rotation")
    return np.asarray(np.linalg.inv(pose), np.float64)


def _sensor(sensor: ElementTree.Element, path: Path) -> _Sensor:
    kind = sensor.get("type", "frame")
    if kind != "frame":
        raise UserError(path, f"its lens model {kind!r} is not supported", "export undistorted photographs and their cameras")
    found = [c for c in sensor.findall("calibration") if c.find("f") is not None or c.find("fx") is not None]
    if not found:
        raise ValueError("a sensor has no calibration")
    calibration = next((c for c in found if c.get("class") == "adjusted"), found[0])
    resolution = calibration.find("resolution")
    resolution = resolution if resolution is not None else sensor.find("resolution")
    if resolution is None:
        raise ValueError("a sensor has no resolution")
    width, height = int(resolution.get("width", 0)), int(resolution.get("height", 0))

    def value(name: str, otherwise: float = 0.0) -> float:
        element = calibration.find(name)
        return otherwise if element is None else float(element.text or 0)

    f = value("f", value("fy"))
    fx, fy = (value("fx"), value("fy")) if calibration.find("f") is None else (f + value("b1"), f)
    if width <= 0 or height <= 0 or not fx > 0 or not fy > 0:
        raise ValueError("a sensor's focal length or resolution is not above 0")
    corner = float(np.hypot(width / fx, height / fy)) / 2
    rest = {"k4": value("k4") * corner**9 * fx, "b2": value("b2") * height / 2 / fy}
    bad = [name for name, moved in rest.items() if abs(moved) > SEEN_PX]
    if bad:
        fault = f"its lens has {', '.join(bad)}, which is not supported"
        raise UserError(path, fault, "fit the lens without it in Metashape, or export undistorted photographs")
    k: tuple[float, ...] = (value("k1"), value("k2"), value("p2"), value("p1"))
    model = PINHOLE
    if k3 := value("k3"):
        k, model = (*k, k3, 0.0, 0.0, 0.0), "FULL_OPENCV"
    centre = (width / 2 + value("cx"), height / 2 + value("cy"))
    return _Sensor((width, height), (fx, fy), centre, k if any(k) else (), model)
