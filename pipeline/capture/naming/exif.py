"""What a photograph's header tells of its camera."""

from __future__ import annotations

import math
from pathlib import Path

from pipeline.errors import UserError
from pipeline.formats.images import open_image

FULL_FRAME_DIAGONAL_MM = math.hypot(36.0, 24.0)


def focal_from_exif(path: Path) -> float | None:
    """Focal length in pixels from EXIF, or None where it does not say.

    From the 35 mm equivalent, by the diagonal (which the equivalence keeps when the aspect ratio differs), else from
    the focal length and the focal-plane resolution.
    """
    try:
        image = open_image(path)
    except UserError:
        return None
    spec = image.spec()
    image.close()
    diagonal_px = math.hypot(spec.width, spec.height)
    equivalent = float(spec.getattribute("Exif:FocalLengthIn35mmFilm") or 0)
    if equivalent > 0:
        return equivalent / FULL_FRAME_DIAGONAL_MM * diagonal_px
    focal = float(spec.getattribute("Exif:FocalLength") or 0)
    density = float(spec.getattribute("Exif:FocalPlaneXResolution") or 0)
    unit_mm = {2: 25.4, 3: 10.0, 4: 1.0}.get(int(spec.getattribute("Exif:FocalPlaneResolutionUnit") or 2))
    if focal > 0 and density > 0 and unit_mm:
        return focal * density / unit_mm
    return None
