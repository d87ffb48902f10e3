"""capture.toml: what a capture's files cannot tell by themselves.

Every table is a frozen dataclass; a key that is not a field is an error that names it. `[stage.NAME]` tables are passed
through untouched: the stage checks them against its own parameters.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from pipeline.errors import UserError
from pipeline.formats.bare_arrays import SETTINGS_FILE, SETTINGS_HELP, RawConfig
from pipeline.formats.toml_file import read_toml
from pipeline.formats.typed_values import filled
from pipeline.geometry.world import UP_AXES

MARKERS = (
    *(f"{n}X{n}_{count}" for n in (4, 5, 6, 7) for count in (50, 100, 250, 1000)),
    *("ARUCO_ORIGINAL", "ARUCO_MIP_36H12", "APRILTAG_16H5", "APRILTAG_25H9", "APRILTAG_36H10", "APRILTAG_36H11"),
)
"""OpenCV's predefined marker dictionaries, upper case."""


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
    """From stored numbers to linear radiance: [radiometry]. None: the file decides.

    Fields:
        black_level, white_level: in the file's own numbers.
        encoding: "linear" or "srgb".
        saturation: share of the white level from which a sample counts as clipped.
        exposure_s: seconds by VIEW or file name.
        exif_exposure: divide out exposures that differ between files' headers; None: unless the pixels contradict them.
        dark_frame, flat_field: image files relative to the capture.
        white_balance: factors on R, G, B.
    """

    black_level: float | None = None
    white_level: float | None = None
    encoding: str | None = None
    saturation: float | None = None
    exposure_s: dict[str, float] = field(default_factory=dict)
    exif_exposure: bool | None = None
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
    """Facts that fix cameras: [poses].

    Fields:
        focal_px: focal length, pixels.
        scale_pair: two views whose distance is known.
        scale_distance: that distance, world units.
        marker_length: side of the square ArUco markers in view, world units.
        marker_dictionary: of the markers, as OpenCV names it.
    """

    focal_px: float | None = None
    scale_pair: tuple[str, ...] | None = None
    scale_distance: float | None = None
    marker_length: float | None = None
    marker_dictionary: str = "4X4_50"


@dataclass(frozen=True)
class CaptureConfig:
    """The whole of capture.toml; an absent file is the same as an empty one.

    Fields:
        up: the world's up axis ("y", "z", "-y", ...); None: as the layout has it.
        unit_m: metres per world unit, None: not known.
        layout: name of a layout; None: recognised by its files.
        clean_plate: folder (or file) with photographs of the empty scene, relative to the capture.
        stokes, radiometry, mosaic, stack, raw, olat, poses: tables of these names.
        polarisers: [polarisers.CAMERA] by physical camera.
        stage: [stage.NAME] by stage, unchecked.
        path: the file; None: there is none.
    """

    up: str | None = None
    unit_m: float | None = None
    layout: str | None = None
    clean_plate: str | None = None
    stokes: StokesConfig = StokesConfig()
    polarisers: dict[str, PolariserConfig] = field(default_factory=dict)
    radiometry: RadiometryConfig = RadiometryConfig()
    mosaic: MosaicConfig = MosaicConfig()
    stack: StackConfig = StackConfig()
    raw: RawConfig = field(default_factory=RawConfig)
    olat: OlatConfig = OlatConfig()
    poses: PosesConfig = PosesConfig()
    stage: dict[str, dict[str, Any]] = field(default_factory=dict)
    path: Path | None = None


def load_config(root: Path) -> CaptureConfig:
    """Read ROOT/capture.toml (absent: all defaults). Raises UserError naming the key on anything unknown or of a wrong type."""
    path = root / SETTINGS_FILE
    if not path.is_file():
        if path.is_dir() or path.is_symlink():
            raise UserError(path, "is a folder" if path.is_dir() else "is a link to nothing", SETTINGS_HELP)
        return CaptureConfig()
    config = filled(CaptureConfig, read_toml(path, SETTINGS_HELP), "", str(path), hidden=("path",))
    _check(config, path)
    return dataclasses.replace(config, path=path)


def _check(config: CaptureConfig, path: Path) -> None:
    """Values that have the right type but no meaning."""

    def refuse(condition: bool, key: str, value: object, want: str) -> None:
        if condition:
            raise UserError(path, f"{key} = {value!r} is not {want}", "correct the value")

    refuse(config.up is not None and config.up not in UP_AXES, "up", config.up, f"one of {', '.join(UP_AXES)}")
    refuse(config.unit_m is not None and config.unit_m <= 0, "unit_m", config.unit_m, "above 0")
    _check_poses(config.poses, refuse)
    _check_angles(config, refuse)
    refuse(config.stokes.scale <= 0, "stokes.scale", config.stokes.scale, "a factor above 0")
    radiometry = config.radiometry
    refuse(
        radiometry.encoding not in (None, "linear", "srgb"), "radiometry.encoding", radiometry.encoding, '"linear" or "srgb"'
    )
    refuse(radiometry.saturation is not None and not 0 < radiometry.saturation <= 1,
           "radiometry.saturation", radiometry.saturation, "a fraction of the white level in (0, 1]")  # fmt: skip
    white, black = radiometry.white_level, radiometry.black_level
    refuse(white is not None and white <= (black or 0.0), "radiometry.white_level", white,
           f"above the black level ({black or 0.0:g})")  # fmt: skip
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
    for side in ("width", "height"):
        number = getattr(config.raw, side)
        refuse(number is not None and number <= 0, f"raw.{side}", number, "a number of pixels")
    refuse(config.raw.offset < 0, "raw.offset", config.raw.offset, "a number of bytes")
    refuse(config.olat.irradiance <= 0, "olat.irradiance", config.olat.irradiance, "above 0")
    refuse(config.olat.specular_factor <= 0, "olat.specular_factor", config.olat.specular_factor, "above 0")
    for name, polariser in config.polarisers.items():
        extinction = polariser.extinction
        refuse(extinction is not None and extinction <= 1, f"polarisers.{name}.extinction", extinction, "above 1")


ROUNDED = 0.012
"""Of 15 degrees in radians: what two digits after the point leave open, 0.003."""


def _check_angles(config: CaptureConfig, refuse: Callable[[bool, str, object, str], None]) -> None:
    """Angles that are all multiples of 15 degrees in radians are no degrees."""
    polarisers = {name: p.angle_deg for name, p in config.polarisers.items() if p.angle_deg is not None}
    for key, angles in (("stack.angles_deg", config.stack.angles_deg), ("polarisers", polarisers)):
        turned = [abs(a) for a in angles.values() if a]
        steps = [a / math.radians(15) for a in turned]
        written = bool(turned) and max(turned) <= 2 * math.pi and all(abs(s - round(s)) < ROUNDED for s in steps)
        refuse(
            written, key, {name: float(a) for name, a in angles.items()}, "in degrees: these are multiples of 15° in radians"
        )


def _check_poses(poses: PosesConfig, refuse: Callable[[bool, str, object, str], None]) -> None:
    for key in ("focal_px", "scale_distance", "marker_length"):
        value = getattr(poses, key)
        refuse(value is not None and value <= 0, f"poses.{key}", value, "above 0")
    pair = poses.scale_pair
    refuse(pair is not None and len(set(pair)) != 2, "poses.scale_pair", pair, "two views")
    refuse((pair is None) != (poses.scale_distance is None), "poses.scale_pair", pair, "given with a scale_distance")
    refuse(poses.marker_dictionary.upper() not in MARKERS, "poses.marker_dictionary", poses.marker_dictionary,
           f"one of OpenCV's: {', '.join(MARKERS[:4])}, ... {MARKERS[-1]}")  # fmt: skip
