"""Reading an image some rows at a time as linear float: what is read is converted while it is still in the cache."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.capture.config import RadiometryConfig
from pipeline.capture.naming.exif import header_number
from pipeline.capture.naming.files import FLOAT_SUFFIXES
from pipeline.capture.radiometry.of_file import for_file
from pipeline.errors import UserError
from pipeline.formats.exr_frame import exr_frame
from pipeline.formats.exr_zip import open_zip_exr
from pipeline.formats.image_parts import Page, without_alpha
from pipeline.formats.images import open_image, reason_of, srgb_decode

ROWS = 32
"""Two of EXR's zip blocks: a band of nine half floats 4000 pixels wide is 2.3 MB."""
DEFAULT_SATURATION = 0.98
"""Of the white level: sensors bend before they clip."""


class LinearReader:
    """One open image file (no camera raw), read from top to bottom; close() it.

    names, size (width, height), bits (0: float), orientation (EXIF's), exposure_s and encoding are the file's.
    """

    def __init__(self, path: Path, radiometry: RadiometryConfig, sensor_data: bool = False, page: Page | None = None) -> None:
        """Raises UserError where the file is not there, empty or no image, or holds several and none is chosen (`page`)."""
        radiometry = for_file(radiometry, path)
        self.path, self.radiometry = path, radiometry
        self._image = open_image(path, page, unassociated=page is not None, plain=True)
        spec = self._image.spec()
        self.bits = {"uint8": 8, "uint16": 16, "uint": 32}.get(str(spec.format), 0)
        if self.bits and "A" in spec.channelnames:
            self._image.close()
            self._image = open_image(path, page, unassociated=True, plain=True)
        self.names = tuple(spec.channelnames)
        self.frame = exr_frame(spec, path)
        self.size = self.frame.size
        self.orientation = int(spec.get_int_attribute("Orientation", 1)) if path.suffix.lower() != ".hdr" else 1
        self.exposure_s = header_number(spec, "ExposureTime")
        self.encoding = radiometry.encoding or ("srgb" if self.bits == 8 and not sensor_data else "linear")
        self._top, self._tiled = spec.y, bool(spec.tile_width)
        self._whole: NDArray[Any] | None = None
        half = str(spec.format) == "half" and all(str(f) == "half" for f in spec.channelformats)
        self._kind = f"uint{self.bits}" if self.bits in (8, 16) else "half" if half else "float"
        self._zip = open_zip_exr(path) if path.suffix.lower() == ".exr" else None
        if self._zip is not None and (set(self._zip.layout.names), self._zip.layout.size) != (set(self.names), self.size):
            self._zip.file.close()  # names that OpenImageIO had to change, as one that stands twice
            self._zip = None
        self._alpha = next((i for i, name in enumerate(self.names) if name == "A"), -1)
        if self.bits in (8, 16):
            self._table, self._limit = code_table(self.bits, radiometry, self.encoding)

    def close(self) -> None:
        """Let go of the file."""
        self._image.close()
        if self._zip is not None:
            self._zip.file.close()

    def fill(self, start: int, stop: int, out: NDArray[np.float32], saturated: NDArray[np.bool_]) -> None:
        """Rows start..stop into out [rows, W, C] (contiguous) and saturated [rows, W]. Raises UserError on a file that
        ends too early."""
        from pipeline.formats.sample_kernels import look_up, mark_at_least, widen_halves

        if self._zip is not None:
            place = np.array([self.names.index(name) for name in self._zip.layout.names])
            if not self._zip.read(start, stop, place, out):
                raise self._damage("a chunk cannot be inflated")
            self._level(out, saturated)
            return
        band = np.ascontiguousarray(self._rows(start, stop))
        if self.bits in (8, 16):
            look_up(band.reshape(-1), self._table, out.reshape(-1))
            mark_at_least(band.reshape(-1, band.shape[-1]), self._limit, self._alpha, saturated.reshape(-1))
            if self._alpha >= 0:
                out[..., self._alpha] = band[..., self._alpha] / np.float32(len(self._table) - 1)
            return
        if self._kind == "half":
            flat = out.reshape(-1)
            widen_halves(band.view(np.uint16).reshape(-1), flat, flat.view(np.uint32))
        else:
            out[...] = band
        self._level(out, saturated)
        self.frame.recoloured(out, self.names)

    def _level(self, out: NDArray[np.float32], saturated: NDArray[np.bool_]) -> None:
        apply_levels(out, saturated, self.names, self.bits, self.radiometry, self.encoding)
        if self.encoding == "srgb" and self.path.suffix.lower() not in FLOAT_SUFFIXES:
            out[...] = srgb_decode(out)

    def _rows(self, start: int, stop: int) -> NDArray[Any]:
        """Rows of the picture: black where the file stores no pixel."""
        if self.frame.size == self.frame.stored and self.frame.corner == (0, 0):
            return self._stored_rows(start, stop)
        rows, columns, down, across = self.frame.part(start, stop)
        stored = self._stored_rows(rows.start, rows.stop) if rows.stop > rows.start else None
        kinds = {"half": np.float16, "float": np.float32, "uint8": np.uint8, "uint16": np.uint16}
        out = np.zeros((stop - start, self.size[0], len(self.names)), kinds[self._kind])
        if stored is not None:
            out[down, across] = stored[:, columns]
        return out

    def _stored_rows(self, start: int, stop: int) -> NDArray[Any]:
        width, height = self.frame.stored
        if self._tiled:
            if self._whole is None:
                self._whole = self._checked(self._image.read_image(self._kind)).reshape(height, width, -1)
            return self._whole[start:stop]
        band = self._image.read_scanlines(0, 0, self._top + start, self._top + stop, 0, 0, len(self.names), self._kind)
        return self._checked(band).reshape(stop - start, width, -1)

    def _checked(self, samples: Any) -> NDArray[Any]:
        if samples is None:
            raise self._damage(reason_of(self._image))
        return np.asarray(samples)

    def _damage(self, reason: str) -> UserError:
        return UserError(self.path, f"the image is truncated or corrupt ({reason})", "copy it again from its source")


def code_table(bits: int, radiometry: RadiometryConfig, encoding: str) -> tuple[NDArray[np.float32], int]:
    """Linear value of every code of a `bits`-bit file, and the code from which on a sample is saturated."""
    codes = np.arange(2**bits, dtype=np.float64)
    white = float(codes[-1]) if radiometry.white_level is None else radiometry.white_level
    black = radiometry.black_level or 0.0
    level = min(_saturation(radiometry, encoding) * white, 2.0**bits)  # above the codes: none is saturated
    limit = int(np.ceil(level - 1e-6))  # a product may miss a code by its last bit
    linear = (codes - black) / (white - black)
    return (srgb_decode(linear) if encoding == "srgb" else linear).astype(np.float32), limit


def apply_levels(
    pixels: NDArray[np.float32],
    saturated: NDArray[np.bool_],
    names: tuple[str, ...],
    bits: int,
    radiometry: RadiometryConfig,
    encoding: str,
) -> None:
    """capture.toml's levels on float (or 32-bit) samples [H, W, C] in place; fills where a colour is saturated [H, W]."""
    colour = without_alpha(names)
    saturated[...] = False
    if bits or radiometry.white_level is not None:
        full = float(2**bits - 1) if bits else 1.0
        white = (radiometry.white_level if radiometry.white_level is not None else full) / full
        black = (radiometry.black_level or 0.0) / full
        limit = np.float32(white * _saturation(radiometry, encoding))
        for i in colour:  # a plane at a time: reductions over a short last axis are slow
            saturated |= pixels[..., i] >= limit
            if (black, white) != (0.0, 1.0):
                pixels[..., i] -= np.float32(black)
                pixels[..., i] *= np.float32(1 / (white - black))
    elif radiometry.black_level:
        pixels[..., colour] -= np.float32(radiometry.black_level)


def _saturation(radiometry: RadiometryConfig, encoding: str) -> float:
    """The share of the white level from which on samples count as clipped."""
    return radiometry.saturation or (1.0 if encoding == "srgb" else DEFAULT_SATURATION)
