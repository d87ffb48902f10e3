"""What a photograph's header tells of its camera."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

from pipeline.errors import UserError
from pipeline.formats.images import open_image

FULL_FRAME_DIAGONAL_MM = math.hypot(36.0, 24.0)


def header_number(spec: Any, *names: str) -> float | None:
    """The first of these facts of a header (OpenImageIO's ImageSpec) that is a number above 0, or None."""
    for name in names:
        try:
            value = float(spec.getattribute(name) or 0)
        except (TypeError, ValueError):
            continue
        if value > 0 and math.isfinite(value):
            return value
    return None


def focal_from_exif(path: Path) -> float | None:
    """Read a photograph's focal length from its EXIF header.

    From the 35 mm equivalent, by the diagonal (which the equivalence keeps when the aspect ratio differs), else from the focal
    length and the focal-plane resolution.

    Args:
        path: the photograph.

    Returns:
        Pixels; None where the header does not say, or the file cannot be read.
    """
    try:
        image = open_image(path)
    except UserError:
        return None
    spec = image.spec()
    image.close()
    diagonal_px = math.hypot(spec.width, spec.height)
    equivalent = header_number(spec, "Exif:FocalLengthIn35mmFilm")
    if equivalent:
        return equivalent / FULL_FRAME_DIAGONAL_MM * diagonal_px
    focal = header_number(spec, "Exif:FocalLength")
    density = header_number(spec, "Exif:FocalPlaneXResolution")
    unit_mm = {2: 25.4, 3: 10.0, 4: 1.0}.get(int(header_number(spec, "Exif:FocalPlaneResolutionUnit") or 2))
    if focal and density and unit_mm:
        return focal * density / unit_mm
    return None
