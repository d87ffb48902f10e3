"""Lights that stand in the capture's world, from a TOML or JSON file: directional, spherical and rectangular."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import UserError, nearest
from pipeline.formats.json_file import read_json
from pipeline.formats.toml_file import read_toml
from pipeline.formats.typed_values import filled

REMEDY = "docs/stages.md shows such a file"
Vector = tuple[float, ...]


@dataclass(frozen=True)
class DirectionalLight:
    """A distant disc: `towards` it, its `irradiance` (R G B) on a surface that faces it, its diameter as an angle."""

    towards: Vector
    irradiance: Vector
    angle_deg: float = 0.53  # the sun's


@dataclass(frozen=True)
class SphereLight:
    """A glowing ball: world units, `radiance` R G B."""

    centre: Vector
    radius: float
    radiance: Vector


@dataclass(frozen=True)
class RectangleLight:
    """A glowing rectangle about `centre`, its sides `edge_u` and `edge_v` (world units); it shines to where edge_u x edge_v
    points, or to both sides."""

    centre: Vector
    edge_u: Vector
    edge_v: Vector
    radiance: Vector
    two_sided: bool = False


Light = DirectionalLight | SphereLight | RectangleLight


def moved(lights: Sequence[Light], offset: NDArray[np.float64]) -> list[Light]:
    """The lights in a world whose origin lies at `offset` [3] of theirs."""
    if not offset.any():
        return list(lights)
    return [
        light if isinstance(light, DirectionalLight) else replace(light, centre=tuple(np.asarray(light.centre) - offset))
        for light in lights
    ]


KINDS: dict[str, type] = {"directional": DirectionalLight, "sphere": SphereLight, "rectangle": RectangleLight}


def read_lights(path: Path) -> list[Light]:
    """The lights of a file: tables `[[light]]` with `kind` and the fields of its class. Raises UserError."""
    table = read_json(path) if path.suffix.lower() == ".json" else read_toml(path, REMEDY)
    entries = table.get("light") if isinstance(table, dict) else None
    if not isinstance(entries, list) or not entries or not all(isinstance(e, dict) for e in entries):
        raise UserError(path, "holds no lights", f"give it tables [[light]]; {REMEDY}")
    if unknown := [key for key in table if key != "light"]:
        raise UserError(path, f"unknown key {unknown[0]}", "known here: light")
    return [_light(entry, f"light[{k}]", str(path)) for k, entry in enumerate(entries)]


def _light(entry: Mapping[str, Any], what: str, source: str) -> Light:
    kind = entry.get("kind")
    if kind not in KINDS:
        raise UserError(source, f"{what}.kind = {kind!r} is no kind of light", nearest(str(kind), KINDS))
    fields = {key: value for key, value in entry.items() if key != "kind"}
    try:
        light = filled(KINDS[kind], fields, f"{what}.", source)
    except TypeError as error:  # a field that has no default
        missing = str(error).partition(": ")[2] or str(error)
        raise UserError(source, f"{what} ({kind}) lacks {missing}", REMEDY) from None
    for key, value in vars(light).items():
        if isinstance(value, tuple) and len(value) != 3:
            raise UserError(source, f"{what}.{key} has {len(value)} numbers", "three are needed")
    if fault := _fault(light):
        raise UserError(source, f"{what}: {fault}", "correct it")
    return light


def _fault(light: Light) -> str | None:
    if min(light.irradiance if isinstance(light, DirectionalLight) else light.radiance) < 0:
        return "a light below zero"
    if isinstance(light, DirectionalLight):
        if not any(light.towards):
            return "towards has no direction"
        return None if 0 <= light.angle_deg <= 180 else f"angle_deg = {light.angle_deg:g} is not between 0 and 180"
    if isinstance(light, SphereLight):
        return None if light.radius > 0 else f"radius = {light.radius:g} is not above zero"
    return None if np.cross(light.edge_u, light.edge_v).any() else "edge_u and edge_v lie on one line"
