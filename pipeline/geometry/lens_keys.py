"""The lens that a `transforms.json` frame tells: nerfstudio's and instant-ngp's words for it, COLMAP's names for models.

No coefficient is dropped: one that its model has no place for is refused.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pipeline.errors import UserError
from pipeline.geometry.lens_models import MODELS, PINHOLE, is_pinhole

MODEL_KEY = "camera_model"
SHORTER = {
    "PINHOLE": (PINHOLE, ()),
    "SIMPLE_PINHOLE": (PINHOLE, ()),
    "PERSPECTIVE": (PINHOLE, ("k1", "k2", "p1", "p2")),
    "SIMPLE_RADIAL": (PINHOLE, ("k1",)),
    "RADIAL": (PINHOLE, ("k1", "k2")),
    "SIMPLE_DIVISION": ("DIVISION", ("k",)),
    "FISHEYE": ("OPENCV_FISHEYE", ("k1", "k2", "k3", "k4")),
    "SIMPLE_FISHEYE": ("OPENCV_FISHEYE", ()),
    "SIMPLE_RADIAL_FISHEYE": ("OPENCV_FISHEYE", ("k1",)),
    "RADIAL_FISHEYE": ("OPENCV_FISHEYE", ("k1", "k2")),
}
"""Models that are another one's with fewer coefficients."""
IN_ORDER = ("k1", "k2", "k3", "k4", "p1", "p2")
"""Of nerfstudio's `distortion_params`."""
COEFFICIENTS = tuple(
    dict.fromkeys(
        [*(name for model in MODELS.values() for name in model.names), *IN_ORDER, "k6", "p3", "p4", "s4", "b1", "b2", "skew"]
        + [f"ftheta_p{i}" for i in range(5)]
    )
)
"""Every key that says how a lens bends, in this program's models or others'."""


def number(value: Any, key: str, path: Path, what: str) -> float:
    """A finite number of a table. Raises UserError naming file, frame and key."""
    try:
        if isinstance(value, bool):
            raise TypeError
        found = float(value)
    except (TypeError, ValueError, OverflowError):
        found = math.nan
    if not math.isfinite(found):
        raise UserError(path, f"{what}: {key} = {value!r} is not a finite number", "write it as one")
    return found


def lens_of(frame: Mapping[str, Any], shared: Mapping[str, Any], path: Path, what: str) -> tuple[str, tuple[float, ...]]:
    """Model and coefficients (see `lens_models`) of a frame, from the frame, else from the file. Raises UserError."""
    table = {**shared, **frame}
    name, model, allowed = _model(table, path, what)
    stated = _coefficients(table, path, what)
    if model == PINHOLE and name not in SHORTER and any(stated.get(k) for k in ("k3", "k4", "k5", "k6")):
        if stated.get("k4") and not (stated.get("k5") or stated.get("k6")):
            fault = f"{what}: k4 = {stated['k4']:g} of {name} is Brown's r⁸ to some programs, OpenCV's rational term to others"
            raise UserError(path, fault, "undistort the images, or say camera_model FULL_OPENCV if it is OpenCV's")
        model = "FULL_OPENCV"
        allowed = MODELS[model].names
    spare = [k for k, value in stated.items() if value and k not in allowed]
    if spare:
        remedy = "set camera_model to the model that has it, or remove it if the images are undistorted already"
        raise UserError(path, f"{what}: {spare[0]} = {stated[spare[0]]:g} has no place in the lens model {name}", remedy)
    coefficients = tuple(stated.get(k, 0.0) for k in MODELS[model].names)
    if model == "EUCM" and not (0 <= coefficients[0] <= 1 and coefficients[1] > 0):
        raise UserError(path, f"{what}: EUCM needs alpha in [0, 1] and beta above 0", "add them")
    return model, () if is_pinhole(model, coefficients) else coefficients


def _model(table: Mapping[str, Any], path: Path, what: str) -> tuple[str, str, tuple[str, ...]]:
    """(the name as stated, the model, the coefficients that it has)."""
    stated = table.get(MODEL_KEY)
    if stated is None and table.get("is_fisheye"):
        stated = "OPENCV_FISHEYE"
    if stated is None and (table.get("equirectangular") or table.get("latlong")):
        stated = "EQUIRECTANGULAR"
    name = PINHOLE if stated is None else str(stated).upper()
    if name in SHORTER:
        return name, *SHORTER[name]
    if name not in MODELS:
        fault = f"{what}: the lens model {stated!r} is not understood"
        raise UserError(path, fault, f"undistort the images first; known: {', '.join(known())}")
    return name, name, MODELS[name].names


def coefficient_names(model: str) -> tuple[str, ...]:
    """Name the coefficients of a COLMAP lens model.

    Args:
        model: COLMAP's name for it.

    Returns:
        Names in COLMAP's order; empty for a model that is not known.
    """
    return SHORTER[model][1] if model in SHORTER else MODELS[model].names if model in MODELS else ()


def known() -> tuple[str, ...]:
    """Names of lens models that are read."""
    return (*MODELS, *SHORTER)


def _coefficients(table: Mapping[str, Any], path: Path, what: str) -> dict[str, float]:
    stated = {k: number(table[k], k, path, what) for k in COEFFICIENTS if table.get(k) is not None}
    listed = table.get("distortion_params")
    if listed is not None:
        if not isinstance(listed, list) or len(listed) > len(IN_ORDER):
            fault = f"{what}: distortion_params is not a list of {', '.join(IN_ORDER)}"
            raise UserError(path, fault, "write the coefficients by name")
        stated |= {k: number(v, f"distortion_params ({k})", path, what) for k, v in zip(IN_ORDER, listed)}
    return stated
