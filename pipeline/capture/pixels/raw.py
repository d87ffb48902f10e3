"""Camera raw through LibRaw (rawpy): black and white level, linear, no tone curve, no auto-brightness, no rotation."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.capture.config import RadiometryConfig
from pipeline.capture.pixels.linear_image import LinearImage
from pipeline.errors import UserError
from pipeline.formats.truncation import refuse_truncated

SATURATION = 0.98


def read_raw_rgb(path: Path, radiometry: RadiometryConfig) -> LinearImage:
    """A raw photograph demosaiced in the camera's own colours, 0 at black and 1 at white [H, W, 3]. Raises UserError."""
    import rawpy

    with _opened(path) as raw:
        black, white = _levels(raw, radiometry)
        samples = raw.raw_image_visible
        limit = black.min() + (radiometry.saturation or SATURATION) * (white - black.min())
        clipped = samples >= limit if samples.ndim == 2 else (samples >= limit).any(-1)
        known = radiometry.black_level
        rgb16 = raw.postprocess(
            gamma=(1, 1), no_auto_bright=True, no_auto_scale=True, output_bps=16, user_wb=[1, 1, 1, 1],
            output_color=rawpy.ColorSpace.raw, user_flip=0, user_black=None if known is None else int(known),
        )  # fmt: skip
        exposure = _shutter_s(raw)
        flip = int(raw.sizes.flip)
    rgb = rgb16.astype(np.float32) / np.float32(white - black.mean())
    saturated = _spread(clipped)[: rgb.shape[0], : rgb.shape[1]]
    orientation = {0: 1, 3: 3, 5: 8, 6: 6}.get(flip, 1)
    return LinearImage(rgb, ("R", "G", "B"), saturated, 16, orientation, exposure)


def read_raw_mosaic(path: Path, radiometry: RadiometryConfig) -> LinearImage:
    """The bare sensor samples [H, W, 1], 0 at black and 1 at white. Raises UserError."""
    with _opened(path) as raw:
        black, white = _levels(raw, radiometry)
        samples = raw.raw_image_visible.astype(np.float32)
        if samples.ndim != 2:
            raise UserError(path, "is a raw file without a mosaic", "use the camera's own raw files")
        level = black[raw.raw_colors_visible] if len(black) > 1 else black[0]
        linear = (samples - level) / np.float32(white - black.mean())
        saturated = samples >= black.min() + (radiometry.saturation or SATURATION) * (white - black.min())
        exposure = _shutter_s(raw)
    return LinearImage(linear.astype(np.float32)[..., None], ("Y",), saturated, 16, exposure_s=exposure)


def _opened(path: Path, samples: bool = True) -> Any:
    """An open rawpy image whose `samples` are known to be readable. Raises UserError naming what is wrong."""
    import rawpy

    if not path.is_file():
        raise UserError(path, "no such image", "check the path and the name")
    if path.stat().st_size == 0:
        raise UserError(path, "the file is empty (0 bytes)", "copy it again from its source")
    if path.suffix.lower() == ".dng":
        refuse_truncated(path)
    try:
        raw = rawpy.imread(str(path))
    except rawpy.LibRawFileUnsupportedError:
        raise UserError(path, "is no raw file that LibRaw knows", "convert it to DNG, or export linear 16-bit TIFF") from None
    except rawpy.LibRawError as error:
        raise UserError(path, f"the raw file is truncated or corrupt ({_words(error)})", "copy it again") from None
    if not samples:
        return raw
    try:
        raw.raw_image  # noqa: B018 - truncated data shows only here
    except rawpy.LibRawError as error:
        raw.close()
        raise UserError(path, f"the raw file is truncated ({_words(error)})", "copy it again from its source") from None
    return raw


def _words(error: Exception) -> str:
    text = error.args[0] if error.args else type(error).__name__
    return text.decode(errors="replace") if isinstance(text, bytes) else str(text)


def _levels(raw: Any, radiometry: RadiometryConfig) -> tuple[NDArray[np.float64], float]:
    """Black level of each colour and the white level, in codes; capture.toml's win."""
    known = radiometry.black_level
    black = np.asarray(raw.black_level_per_channel if known is None else [known] * 4, float)
    white = float(raw.white_level if radiometry.white_level is None else radiometry.white_level)
    return black, white


def _spread(clipped: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """A clipped sample invalidates the colours interpolated from it: its neighbours within one pixel."""
    out = clipped.copy()
    out[1:] |= clipped[:-1]
    out[:-1] |= clipped[1:]
    wide = out.copy()
    wide[:, 1:] |= out[:, :-1]
    wide[:, :-1] |= out[:, 1:]
    return wide


def raw_size(path: Path) -> tuple[int, int]:
    """(width, height) of the visible area. Raises UserError."""
    with _opened(path) as raw:
        return int(raw.sizes.width), int(raw.sizes.height)


def raw_preview(path: Path) -> NDArray[np.float32]:
    """The camera's own small JPEG in a raw file, sRGB-encoded [h, w, 3] in 0..1. Raises UserError where it has none."""
    import cv2
    import rawpy

    with _opened(path) as raw:
        try:
            thumb = raw.extract_thumb()
        except rawpy.LibRawError:
            raise UserError(path, "holds no preview", "export it as linear 16-bit TIFF") from None
        if thumb.format == rawpy.ThumbFormat.JPEG:
            picture = cv2.imdecode(np.frombuffer(thumb.data, np.uint8), cv2.IMREAD_COLOR_RGB | cv2.IMREAD_IGNORE_ORIENTATION)
        else:
            picture = np.asarray(thumb.data)
    if picture is None or picture.ndim != 3:
        raise UserError(path, "holds no preview that can be read", "export it as linear 16-bit TIFF")
    return picture.astype(np.float32) / np.float32(255)


def raw_exposure(path: Path) -> tuple[float | None, float | None, float | None]:
    """(seconds, ISO speed, f-number) from the header; None for what it does not tell. Raises UserError."""
    with _opened(path, samples=False) as raw:
        other = raw.other
        return _shutter_s(raw), float(other.iso_speed or 0) or None, float(other.aperture or 0) or None


def _shutter_s(raw: Any) -> float | None:
    return float(raw.other.shutter_speed or 0) or None
