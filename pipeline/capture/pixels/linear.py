"""One image file to linear radiance: encoding, levels, exposure; no tone curve, no guessing from pixel values."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pipeline.capture.config import RadiometryConfig
from pipeline.capture.naming.files import RAW_SUFFIXES
from pipeline.capture.pixels.frame_memory import frame_array
from pipeline.capture.pixels.linear_image import LinearImage
from pipeline.capture.pixels.row_bands import ROWS, LinearReader
from pipeline.capture.radiometry.of_file import factor_of
from pipeline.errors import UserError
from pipeline.formats.image_parts import Page


def read_linear(path: Path, radiometry: RadiometryConfig, sensor_data: bool = False, page: Page | None = None) -> LinearImage:
    """Read any image file as linear radiance.

    8-bit files are sRGB, unless capture.toml says linear or they are `sensor_data`; 16-bit and float files are linear. Levels
    of capture.toml (`black_level`, `white_level`) map to 0 and 1.

    Args:
        path: the image, camera raw too.
        radiometry: what is known of it.
        sensor_data: it is a mosaic straight from the sensor, one channel of camera raw.
        page: one image of a file that holds several.

    Returns:
        float32 pixels in the file's own orientation (EXIF rotation is not applied), clipped samples and what the header says.

    Raises:
        UserError: the file cannot be read, or does not fit capture.toml.
    """
    if path.suffix.lower() in RAW_SUFFIXES:
        from pipeline.capture.pixels.raw import read_raw_mosaic, read_raw_rgb

        image = (read_raw_mosaic if sensor_data else read_raw_rgb)(path, radiometry)
        return calibrated(image, path, radiometry, sensor_data)
    reader = LinearReader(path, radiometry, sensor_data, page)
    width, height = reader.size
    pixels = frame_array((height, width, len(reader.names)))
    saturated = np.empty((height, width), bool)
    try:
        for start in range(0, height, ROWS):
            stop = min(start + ROWS, height)
            reader.fill(start, stop, pixels[start:stop], saturated[start:stop])
    finally:
        reader.close()
    facts = (reader.bits, reader.orientation, reader.exposure_s, reader.encoding, reader.frame)
    linear = LinearImage(pixels, reader.names, saturated, *facts)
    return calibrated(linear, path, radiometry, sensor_data)


def calibrated(image: LinearImage, path: Path, radiometry: RadiometryConfig, sensor_data: bool) -> LinearImage:
    """Less the dark frame, over the flat field (whose mean is kept), at the usual exposure where the file's differs; in place.
    Raises UserError on other sizes."""
    colour = image.colours
    bare = replace(radiometry, dark_frame=None, flat_field=None)
    dark: NDArray[np.float32] | np.float32 = np.float32(0)
    if radiometry.dark_frame:
        dark = _reference(path, radiometry.dark_frame, bare, image, sensor_data)
        image.pixels[..., colour] -= dark
    if radiometry.flat_field:
        flat = _reference(path, radiometry.flat_field, bare, image, sensor_data) - dark
        if not flat.min() > 0:
            raise UserError(
                _beside(path, radiometry.flat_field),
                "the flat field has black pixels",
                "expose it brighter, or give its dark frame",
            )
        image.pixels[..., colour] /= flat / flat.mean((0, 1))
    if (factor := factor_of(radiometry, path)) != 1:
        image.pixels[..., colour] *= np.float32(factor)
    return image


def _beside(path: Path, name: str) -> Path:
    """The file `name`, relative to the capture that `path` lies in. Raises UserError."""
    found = next((parent / name for parent in path.parents if (parent / name).is_file()), None)
    if found is None or found == path:
        raise UserError(name, "named in capture.toml but not there", "give its path relative to the capture")
    return found


def _reference(
    path: Path, name: str, radiometry: RadiometryConfig, image: LinearImage, sensor_data: bool
) -> NDArray[np.float32]:
    """A dark frame or flat field [H, W, colours] of the capture that `path` lies in, in the encoding of its `image`."""
    found = _beside(path, name)
    reference = read_linear(found, radiometry, sensor_data)
    if reference.bits == image.bits and reference.encoding != image.encoding:
        reference = read_linear(found, replace(radiometry, encoding=image.encoding), sensor_data)
    pixels = reference.pixels[..., reference.colours]
    if pixels.shape != (*image.pixels.shape[:2], len(image.colours)):
        raise UserError(
            found, f"has the shape {pixels.shape}, {path.name} {image.pixels.shape}", "take it with the same camera"
        )
    return pixels


def all_finite(samples: NDArray[np.float32]) -> bool:
    """Whether every sample is finite. A finite sum has finite terms; one that is not may only have overflowed."""
    with np.errstate(over="ignore", invalid="ignore"):
        return bool(np.isfinite(samples.sum())) or bool(np.isfinite(samples).all())


def fill_holes(image: NDArray[np.float32]) -> NDArray[np.bool_] | None:
    """Replace non-finite pixels of [H, W, ...] in place by their nearest finite neighbour (zero if there is none).

    Returns where they were [H, W], or None if there were none.
    """
    if all_finite(image):
        return None
    flat = image.reshape(*image.shape[:2], -1)
    holes: NDArray[np.bool_] = np.any(~np.isfinite(flat), axis=-1)
    if holes.all():
        flat[:] = 0
        return holes
    from scipy.ndimage import distance_transform_edt

    row, column = distance_transform_edt(holes, return_distances=False, return_indices=True)
    flat[holes] = flat[row[holes], column[holes]]
    return holes
