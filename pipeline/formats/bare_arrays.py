"""Files of samples without an image header: NumPy's .npy, and .raw of the size and format that capture.toml tells."""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import UserError
from pipeline.formats.arrays import read_array
from pipeline.formats.toml_file import read_toml
from pipeline.formats.typed_values import typed

ARRAY_SUFFIXES = frozenset({".npy", ".raw"})
FORMAT = re.compile(r"^(mono|bayer(?:rg|gb|gr|bg)|rgb|polarized\w*mono)(8|10|12|14|16)(p|packed)?$", re.IGNORECASE)
PACKED = {("10", "p"): 5, ("12", "p"): 3, ("12", "packed"): 3}
"""Bytes of a group of samples (four of 10 bits, two of 12 bits)."""
SET = 'set raw.width, raw.height and raw.format (as "Mono8", "Mono12p", "Mono16") in capture.toml'
SETTINGS_FILE = "capture.toml"
SETTINGS_HELP = "correct it; docs/captures.md has an example"


@dataclass(frozen=True)
class RawConfig:
    """Samples without a header (.raw): what the file cannot say of itself.

    Fields:
        width, height: pixels; None: not set, and reading such a file is refused.
        format: as GenICam names it (Mono8, Mono12p, Mono12Packed, BayerRG16, ...); None: not set.
        offset: bytes before the first sample.
        big_endian: byte order of samples of two bytes.
    """

    width: int | None = None
    height: int | None = None
    format: str | None = None
    offset: int = 0
    big_endian: bool = False


class ArrayInput:
    """The part of OpenImageIO's ImageInput that our readers use, over arrays [H, W, C] in memory.

    `white_level`: the largest code that the format can hold, where that is not its type's (None: its type's).
    """

    def __init__(self, images: list[NDArray[Any]], white_level: float | None = None) -> None:
        """Images of one size and type."""
        self._images, self._at, self.white_level = images, 0, white_level

    def seek_subimage(self, subimage: int, level: int) -> bool:
        """Go to an image; whether it is there."""
        there = 0 <= subimage < len(self._images)
        self._at = subimage if there else self._at
        return there

    def spec(self) -> Any:
        """A header for the image."""
        import OpenImageIO as oiio

        height, width, count = self._images[self._at].shape
        names = {1: ("Y",), 3: ("R", "G", "B"), 4: ("R", "G", "B", "A")}.get(count)
        kind = {"uint8": "uint8", "uint16": "uint16", "float16": "half"}.get(self._images[0].dtype.name, "float")
        spec = oiio.ImageSpec(width, height, count, kind)
        spec.channelnames = names or tuple(f"channel{k}" for k in range(count))
        spec.attribute("oiio:subimages", len(self._images))
        return spec

    def read_image(self, *arguments: Any) -> NDArray[Any]:
        """All samples as the kind asked for last; integers as floats are shares of their type's largest."""
        return _as(self._images[self._at], arguments[-1])

    def read_scanlines(self, subimage: int, level: int, top: int, bottom: int, *more: Any) -> NDArray[Any]:
        """Rows [top, bottom) of an image."""
        return _as(self._images[subimage][top:bottom], more[-1])

    def geterror(self) -> str:
        """Nothing goes wrong after opening."""
        return ""

    def close(self) -> bool:
        """Let go of the samples."""
        self._images = self._images[:0]
        return True


def _as(samples: NDArray[Any], kind: str) -> NDArray[Any]:
    if kind in ("float", "half") and samples.dtype.kind == "u":
        samples = samples.astype(np.float32) / np.float32(np.iinfo(samples.dtype).max)
    return samples.astype({"half": np.float16, "float": np.float32}.get(kind, kind), copy=False)


def open_array(path: Path) -> ArrayInput:
    """The samples of a .npy or .raw file. Raises UserError naming what is wrong with it or not known."""
    return _open_npy(path) if path.suffix.lower() == ".npy" else _open_raw(path)


def _open_npy(path: Path) -> ArrayInput:
    """[H, W] or [H, W, 1]: grey; [H, W, 3]: colour; [H, W, 4] and [4, H, W]: four planes, whose meaning is looked for."""
    array = read_array(path)
    shape = f"holds an array of shape {array.shape}"
    if array.dtype.kind not in "uif" or array.ndim not in (2, 3) or 0 in array.shape:
        raise UserError(path, f"{shape} and type {array.dtype}", "expected numbers [H, W] or [H, W, 3]")
    if array.ndim == 2:
        array = array[..., None]
    planes = array.shape[0] == 4 and min(array.shape[1:]) > 4
    if not planes and array.shape[2] not in (1, 3, 4):
        raise UserError(path, f"{shape}, no image", "save a mosaic as [H, W], colour as [H, W, 3], angles as [4, H, W]")
    array = _plain_type(array, path)
    return ArrayInput([plane[..., None] for plane in array] if planes else [array])


def _plain_type(array: NDArray[Any], path: Path) -> NDArray[Any]:
    """The array as one of the types that image files have."""
    if array.dtype.kind == "f":
        return np.ascontiguousarray(array, np.float16 if array.dtype.itemsize == 2 else np.float32)
    if array.dtype.itemsize == 1 and array.dtype.kind == "u":
        return np.ascontiguousarray(array)
    if array.min() < 0 or array.max() > 65535:
        raise UserError(path, f"its codes {array.min()} .. {array.max()} are no 16-bit samples", "save it as uint16 or float32")
    return np.ascontiguousarray(array, np.uint16)


def _open_raw(path: Path) -> ArrayInput:
    config, where = _raw_config(path)
    if config.width is None or config.height is None or config.format is None:
        raise UserError(path, "holds bare samples: their size and format are not in the file", SET)
    match = FORMAT.match(config.format)
    if match is None or (match[3] and (match[2], match[3].lower()) not in PACKED):
        known = "known: Mono8 .. Mono16, Mono10p, Mono12p, Mono12Packed, BayerRG8 and so on, RGB8"
        raise UserError(where, f"raw.format = {config.format!r} is not known", known)
    colours = 3 if match[1].lower() == "rgb" else 4 if match[1].lower().startswith("polarized") else 1
    count = config.width * config.height * colours
    group = PACKED.get((match[2], (match[3] or "").lower()))
    bits = int(match[2])
    need = -(-count * bits // 8) if group else count * (1 if bits == 8 else 2)
    have = path.stat().st_size - config.offset
    if have != need:
        size = f"{config.width}x{config.height} {config.format}"
        mend = "mend raw.width, raw.height, raw.format or raw.offset in capture.toml"
        raise UserError(path, f"has {have} bytes of samples, {size} has {need}", mend)
    data = np.fromfile(path, np.uint8, offset=config.offset)
    samples: NDArray[Any]
    if group:
        samples = unpacked(data, bits, match[3].lower(), count)
    elif bits == 8:
        samples = data
    else:
        samples = data.view(">u2" if config.big_endian else "<u2").astype(np.uint16)
    white = None if bits in (8, 16) else float(2**bits - 1)
    image = samples.reshape(config.height, config.width, colours)
    return ArrayInput([image[..., k : k + 1] for k in range(4)] if colours == 4 else [image], white)


def unpacked(data: NDArray[np.uint8], bits: int, style: str, count: int) -> NDArray[np.uint16]:
    """`count` samples of 10 or 12 bits from their bytes: GenICam's "p" (least bit first) or GigE Vision's "packed" (12 bits:
    the high bytes of two samples around a byte of their low halves)."""
    group = PACKED[str(bits), style]
    padded = np.zeros(-(-len(data) // group) * group, np.uint8)
    padded[: len(data)] = data
    bytes_ = padded.reshape(-1, group).astype(np.uint64)
    if style == "packed":
        low, middle, high = bytes_.T
        return np.stack([low << 4 | middle & 15, high << 4 | middle >> 4], -1).ravel()[:count].astype(np.uint16)
    word = sum(bytes_[:, k] << np.uint64(8 * k) for k in range(group))
    samples = [word >> np.uint64(bits * k) & np.uint64(2**bits - 1) for k in range(8 * group // bits)]
    return np.stack(samples, -1).ravel()[:count].astype(np.uint16)


def _raw_config(path: Path) -> tuple[RawConfig, Path]:
    """capture.toml's [raw] of the capture that `path` lies in, and that file. Raises UserError."""
    for folder in path.absolute().parents:
        settings = folder / SETTINGS_FILE
        if settings.is_file():
            return _settings(settings, settings.stat().st_mtime_ns), settings
    return RawConfig(), path


@lru_cache(maxsize=8)
def _settings(path: Path, changed: int) -> RawConfig:
    """The table [raw]; `changed` (nanoseconds): a file that was written anew is read anew."""
    config: RawConfig = typed(read_toml(path, SETTINGS_HELP).get("raw", {}), RawConfig, "raw", str(path))
    return config
