"""capture.toml: what a capture's files cannot tell by themselves.

Every table is a frozen dataclass; a key that is not a field is an error that names it. `[stage.NAME]` tables are passed
through untouched: the stage checks them against its own parameters.
"""

from __future__ import annotations

import dataclasses
import tomllib
import types
import typing
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from pipeline.errors import UserError

UP_AXES = ("y", "-y", "z", "-z", "x", "-x")


@dataclass(frozen=True)
class StokesConfig:
    """How the files' Stokes frame relates to ours; applied once, on reading: scale, then flip, then rotation."""

    scale: float = 1.0
    flip_s2: bool = False
    rotate_deg: float = 0.0


@dataclass(frozen=True)
class PolariserConfig:
    """One physical camera's polariser; `angle_deg` counter-clockwise from the image's x axis as displayed."""

    angle_deg: float | None = None
    trusted: bool = True
    extinction: float | None = None


@dataclass(frozen=True)
class RadiometryConfig:
    """From stored numbers to linear radiance. Levels are in the file's own numbers (None: the file tells).

    `saturation` is a fraction of the white level; `exposure_s` maps VIEW (or file stem) to seconds;
    `dark_frame` and `flat_field` are image files relative to the capture; `white_balance` multiplies R, G, B.
    """

    black_level: float | None = None
    white_level: float | None = None
    encoding: str | None = None
    saturation: float | None = None
    exposure_s: dict[str, float] = field(default_factory=dict)
    dark_frame: str | None = None
    flat_field: str | None = None
    white_balance: tuple[float, ...] | None = None


@dataclass(frozen=True)
class MosaicConfig:
    """A polarisation sensor. `order`: the angles (degrees) of a 2x2 block, row by row from the top left.

    `colour`: "mono" or "bayer" (each colour of the RGGB-like `bayer` pattern covers one 2x2 polariser block).
    """

    order: tuple[float, ...] = (90.0, 45.0, 135.0, 0.0)
    colour: str | None = None
    bayer: str = "RGGB"
    demosaic: str = "carriers"


@dataclass(frozen=True)
class StackConfig:
    """Angle stacks. `angles_deg`: the polariser's angle of each file suffix; `clockwise`: angles turn the other way;
    `align`: lay each picture on the first (the camera or the filter moved the image)."""

    angles_deg: dict[str, float] = field(default_factory=dict)
    clockwise: bool = False
    zero_deg: float = 0.0
    align: bool = False


@dataclass(frozen=True)
class OlatConfig:
    """Light-stage facts (see docs/light_stage.md). `first_frame`: the number of the frame of the light with index 0."""

    lights: str | None = None
    first_frame: int | None = None
    irradiance: float = 3.141592653589793
    near_light: bool = False
    distortion: bool = False
    specular_factor: float = 2.0


@dataclass(frozen=True)
class PosesConfig:
    """Facts that fix cameras: `focal_px` (known focal length), `scale_pair` = two views and their distance in world units,
    or `marker_length` = a side of the square ArUco markers in view, of `marker_dictionary` as OpenCV names it.
    """

    focal_px: float | None = None
    scale_pair: tuple[str, ...] | None = None
    scale_distance: float | None = None
    marker_length: float | None = None
    marker_dictionary: str = "4X4_50"


@dataclass(frozen=True)
class CaptureConfig:
    """The whole of capture.toml; an absent file is the same as an empty one."""

    up: str | None = None
    unit_m: float | None = None
    layout: str | None = None
    clean_plate: str | None = None
    stokes: StokesConfig = StokesConfig()
    polarisers: dict[str, PolariserConfig] = field(default_factory=dict)
    radiometry: RadiometryConfig = RadiometryConfig()
    mosaic: MosaicConfig = MosaicConfig()
    stack: StackConfig = StackConfig()
    olat: OlatConfig = OlatConfig()
    poses: PosesConfig = PosesConfig()
    stage: dict[str, dict[str, Any]] = field(default_factory=dict)
    path: Path | None = None


def load_config(root: Path) -> CaptureConfig:
    """Read ROOT/capture.toml (absent: all defaults). Raises UserError naming the key on anything unknown or of a wrong type."""
    path = root / "capture.toml"
    if not path.is_file():
        return CaptureConfig()
    try:
        table = tomllib.loads(path.read_text(encoding="utf-8-sig"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError, RecursionError) as error:
        raise UserError(path, f"is not valid TOML: {error}", "correct it; docs/captures.md has an example") from None
    config = _fill(CaptureConfig, table, path, "", hidden=("path",))
    _check(config, path)
    return dataclasses.replace(config, path=path)


def _fill(cls: Any, table: dict[str, Any], path: Path, prefix: str, hidden: tuple[str, ...] = ()) -> Any:
    hints = typing.get_type_hints(cls)
    known = [f.name for f in dataclasses.fields(cls) if f.name not in hidden]
    values = {}
    for key, value in table.items():
        if key not in known:
            raise UserError(path, f"unknown key {prefix}{key}", f"known here: {', '.join(known)}")
        values[key] = _convert(hints[key], value, path, f"{prefix}{key}")
    return cls(**values)


def _convert(hint: Any, value: Any, path: Path, key: str) -> Any:
    """`value` as the type `hint`; only the few kinds of type that the tables above use."""
    if isinstance(hint, types.UnionType):
        hint = next(a for a in typing.get_args(hint) if a is not type(None))
    origin, arguments = typing.get_origin(hint), typing.get_args(hint)
    wrong = UserError(path, f"{key} = {value!r} is not {_spoken(hint)}", "correct the value")
    if dataclasses.is_dataclass(hint):
        if not isinstance(value, dict):
            raise wrong
        return _fill(hint, value, path, f"{key}.")
    if origin is dict:
        if not isinstance(value, dict):
            raise wrong
        return {str(k): _convert(arguments[1], v, path, f"{key}.{k}") for k, v in value.items()}
    if origin is tuple:
        if not isinstance(value, list):
            raise wrong
        return tuple(_convert(arguments[0], v, path, f"{key}[{i}]") for i, v in enumerate(value))
    if hint is Any:
        return value
    if hint is float:
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise wrong
        return float(value)
    if not isinstance(value, hint) or (hint is int and isinstance(value, bool)):
        raise wrong
    return value


def _spoken(hint: Any) -> str:
    names = {float: "a number", int: "a whole number", bool: "true or false", str: "text"}
    origin = typing.get_origin(hint)
    return names.get(hint) or {dict: "a table", tuple: "a list"}.get(origin) or "a table"


def _check(config: CaptureConfig, path: Path) -> None:
    """Values that have the right type but no meaning."""

    def refuse(condition: bool, key: str, value: object, want: str) -> None:
        if condition:
            raise UserError(path, f"{key} = {value!r} is not {want}", "correct the value")

    refuse(config.up is not None and config.up not in UP_AXES, "up", config.up, f"one of {', '.join(UP_AXES)}")
    refuse(config.unit_m is not None and config.unit_m <= 0, "unit_m", config.unit_m, "above 0")
    refuse(config.stokes.scale == 0, "stokes.scale", config.stokes.scale, "a factor other than 0")
    radiometry = config.radiometry
    refuse(
        radiometry.encoding not in (None, "linear", "srgb"), "radiometry.encoding", radiometry.encoding, '"linear" or "srgb"'
    )
    refuse(radiometry.saturation is not None and not 0 < radiometry.saturation <= 1,
           "radiometry.saturation", radiometry.saturation, "a fraction of the white level in (0, 1]")  # fmt: skip
    for view, seconds in radiometry.exposure_s.items():
        refuse(seconds <= 0, f"radiometry.exposure_s.{view}", seconds, "above 0 seconds")
    balance = radiometry.white_balance
    refuse(
        balance is not None and (len(balance) != 3 or min(balance) <= 0),
        "radiometry.white_balance",
        balance,
        "three positive factors",
    )
    mosaic = config.mosaic
    refuse(
        len(mosaic.order) != 4 or len({a % 180 for a in mosaic.order}) < 3,
        "mosaic.order",
        mosaic.order,
        "four angles, three of them different",
    )
    refuse(mosaic.colour not in (None, "mono", "bayer"), "mosaic.colour", mosaic.colour, '"mono" or "bayer"')
    refuse(
        mosaic.bayer.upper() not in ("RGGB", "BGGR", "GRBG", "GBRG"), "mosaic.bayer", mosaic.bayer, "RGGB, BGGR, GRBG or GBRG"
    )
    refuse(mosaic.demosaic not in ("carriers", "bilinear"), "mosaic.demosaic", mosaic.demosaic, '"carriers" or "bilinear"')
    refuse(config.olat.irradiance <= 0, "olat.irradiance", config.olat.irradiance, "above 0")
    for name, polariser in config.polarisers.items():
        extinction = polariser.extinction
        refuse(extinction is not None and extinction <= 1, f"polarisers.{name}.extinction", extinction, "above 1")
