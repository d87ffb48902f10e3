"""Images in and out through OpenImageIO: linear float EXR and HDR by channel name, PNG for eyes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pipeline.errors import UserError
from pipeline.formats.exr_frame import ExrFrame, exr_frame
from pipeline.formats.image_output import oiio_library, reason_of, write_pixels
from pipeline.formats.truncation import refuse_blank, refuse_garbled_name, refuse_truncated

if TYPE_CHECKING:
    from pipeline.formats.image_parts import Page

RGB, XYZ = ("R", "G", "B"), ("X", "Y", "Z")
STOKES = tuple(f"S{k}.{c}" for k in range(3) for c in RGB)
S0 = STOKES[:3]
EXR_COMPRESSION = "zip:2"
"""Measured on 12 Mpx of noisy Stokes halves against zip's usual level 4: 12 % less time, 0.7 % more bytes (renders:
the same bytes). Level 1 saves 26 % of the time and costs 1 to 4 % more; PIZ is 45 % faster on noise, 30 % larger on renders."""
HALF_MAX = 65504.0  # the largest half float; larger radiances would become Inf on disk


def open_image(path: Path, page: Page | None = None, unassociated: bool = False, plain: bool = False) -> Any:
    """Open an image for reading; the caller closes it.

    Args:
        path: the file.
        page: one image of a file of several; None: what they mean together (`pipeline.formats.image_parts`).
        unassociated: give colour without alpha multiplied into it, as PNG stores it.
        plain: name the channels of the layer that is the picture R, G, B.

    Returns:
        An OpenImageIO ImageInput, or an object with the methods of one that are used here.

    Raises:
        UserError: the file is missing, empty, truncated or no image, or holds several images of which none is meant.
    """
    from pipeline.formats.image_parts import chosen

    image = open_whole(path, unassociated)
    try:
        return chosen(image, path, page, plain)
    except UserError:
        image.close()
        raise


def open_whole(path: Path, unassociated: bool = False) -> Any:
    """Open a file at its first image, however many it holds (`open_image` decides which is meant).

    Args:
        path: the file.
        unassociated: give colour without alpha multiplied into it, as PNG stores it.

    Returns:
        An OpenImageIO ImageInput, or of arrays without a header an object with its methods.

    Raises:
        UserError: the file is missing, empty, truncated or no image.
    """
    from pipeline.formats.bare_arrays import ARRAY_SUFFIXES, open_array

    if not path.is_file():
        raise UserError(path, "no such image", "check the path and the name")
    refuse_garbled_name(path)
    if path.stat().st_size == 0:
        raise UserError(path, "the file is empty (0 bytes)", "copy it again from its source")
    if path.suffix.lower() in (".png", ".jpg", ".jpeg"):
        refuse_truncated(path)
    if path.suffix.lower() in ARRAY_SUFFIXES:
        return open_array(path)
    refuse_blank(path)
    how = oiio_library().ImageSpec()
    if unassociated:
        how.attribute("oiio:UnassociatedAlpha", 1)
    image = oiio_library().ImageInput.open(str(path), how)
    if image is None:
        raise UserError(path, f"cannot be read as an image ({reason_of(oiio_library())})", "copy it again or remove it")
    return image


def image_size(path: str | Path, page: Page | None = None) -> tuple[int, int]:
    """Read an image's size from its header alone.

    Args:
        path: the file.
        page: one image of a file of several; None: what they mean together.

    Returns:
        Width, height in pixels (of an EXR: of its display window).

    Raises:
        UserError: as `open_image`.
    """
    return picture_frame(path, page).size


def picture_frame(path: str | Path, page: Page | None = None) -> ExrFrame:
    """Read from an image's header where its pixels lie in the picture and what becomes of their colours.

    Args:
        path: the file.
        page: one image of a file of several; None: what they mean together.

    Returns:
        The frame.

    Raises:
        UserError: as `open_image`, or the windows of an EXR are senseless.
    """
    image = open_image(Path(path), page)
    spec = image.spec()
    image.close()
    return exr_frame(spec, Path(path))


def channel_names(path: str | Path, plain: bool = False) -> list[str]:
    """Read an image's channel names from its header alone.

    Args:
        path: the file.
        plain: name the channels of the layer that is the picture R, G, B.

    Returns:
        Names in file order.

    Raises:
        UserError: the file is missing, damaged, or holds several images of which none is meant.
    """
    image = open_image(Path(path), plain=plain)
    names = list(image.spec().channelnames)
    image.close()
    return names


def read_stored(path: Path, plain: bool = False) -> tuple[np.ndarray, list[str], str]:
    """Read an image as it is stored; of an EXR its display window, in Rec. 709 (`exr_frame`).

    Args:
        path: the file.
        plain: name the channels of the layer that is the picture R, G, B.

    Returns:
        Pixels float32 [H, W, C]; channel names; sample format on disk, such as "half".

    Raises:
        UserError: the file is missing, truncated or corrupt, or holds several images of which none is meant.
    """
    image = open_image(path, plain=plain)
    spec = image.spec()
    frame = exr_frame(spec, path)
    pixels = image.read_image("float")
    error = reason_of(image) if pixels is None else ""
    image.close()
    if pixels is None:
        raise UserError(path, f"the image is truncated or corrupt ({error})", "copy it again from its source")
    pixels = np.asarray(pixels, np.float32).reshape(spec.height, spec.width, -1)
    return frame.picture(pixels, spec.channelnames), list(spec.channelnames), str(spec.format)


def read_exr(path: str | Path) -> dict[str, np.ndarray]:
    """Read every channel of an EXR.

    Args:
        path: the file.

    Returns:
        Channel name to its values as stored (linear), float32. [H, W] each

    Raises:
        UserError: the file is missing, truncated or corrupt.
    """
    pixels, names, _ = read_stored(Path(path))
    return {name: np.ascontiguousarray(pixels[..., i]) for i, name in enumerate(names)}


def read_image(path: str | Path, channels: Sequence[str] | None = None) -> np.ndarray:
    """Read an image's pixels.

    Args:
        path: any image that OpenImageIO reads, or an array file.
        channels: names, in the order wanted, case ignored; None: all, in file order.

    Returns:
        Values as stored, float32; integers are scaled to 0..1 by their type's largest. [H, W, C]

    Raises:
        UserError: the file is missing, truncated, corrupt or lacks a channel.
    """
    from pipeline.formats.image_parts import plain_names

    path = Path(path)
    pixels, names, _ = read_stored(path)
    if channels is None:
        return pixels
    lower = [name.lower() for name in names]
    missing = [c for c in channels if c.lower() not in lower]
    if missing:
        lower = [name.lower() for name in plain_names(tuple(names), path)]
        missing = [c for c in channels if c.lower() not in lower]
    if missing:
        raise UserError(path, f"no channel {', '.join(missing)} (it has {', '.join(names)})", "export it with these channels")
    return np.stack([pixels[..., lower.index(c.lower())] for c in channels], -1)


def read_stokes(path: str | Path) -> np.ndarray:
    """Read a Stokes image of our own.

    Args:
        path: an EXR with channels S0.R .. S2.B.

    Returns:
        s0, s1, s2 by R, G, B, linear radiance, in the frame of docs/conventions.md. [H, W, 3, 3]

    Raises:
        UserError: the file is missing, truncated, corrupt or lacks a channel.
    """
    pixels = read_image(path, STOKES)
    return pixels.reshape(*pixels.shape[:2], 3, 3)


def write_stokes(path: str | Path, stokes: np.ndarray, half: bool = False, peak: float | None = None) -> None:
    """Write a Stokes image as an EXR with channels S0.R .. S2.B.

    Args:
        path: the file; its folder exists.
        stokes: s0, s1, s2 by R, G, B, linear radiance. [H, W, 3, 3]
        half: use half floats, unless a value would overflow them.
        peak: largest magnitude in `stokes`, where known: spares looking for it.

    Raises:
        UserError: the file cannot be written.
    """
    flat = np.ascontiguousarray(stokes, np.float32).reshape(*stokes.shape[:2], 9)
    half = half and (_fits_half(flat) if peak is None else peak <= HALF_MAX)
    write_pixels(Path(path), flat, "half" if half else "float", list(STOKES), {"compression": EXR_COMPRESSION})


def write_exr(path: str | Path, channels: Mapping[str, np.ndarray], half: bool = False) -> None:
    """Write named channels as a zip-compressed EXR whose bytes depend on the pixels alone.

    Args:
        path: the file; its folder exists.
        channels: by name. [H, W] each
        half: use half floats, unless a value would overflow them.

    Raises:
        UserError: the file cannot be written.
    """
    names = list(channels)
    pixels = np.ascontiguousarray(np.stack([np.asarray(channels[n], np.float32) for n in names], -1))
    half = half and _fits_half(pixels)
    write_pixels(Path(path), pixels, "half" if half else "float", names, {"compression": EXR_COMPRESSION})


def _fits_half(pixels: np.ndarray) -> bool:
    return not pixels.size or (float(pixels.max()) <= HALF_MAX and float(pixels.min()) >= -HALF_MAX)


def write_rgb(path: str | Path, rgb: np.ndarray) -> None:
    """Write a colour image as .exr or .hdr, by the path's suffix.

    Args:
        path: the file; its folder exists.
        rgb: linear. [H, W, 3]

    Raises:
        UserError: the file cannot be written.
    """
    write_pixels(Path(path), np.ascontiguousarray(rgb, np.float32), "float", list(RGB), {"compression": EXR_COMPRESSION})


def write_png(path: str | Path, pixels: np.ndarray, bits: int = 8) -> None:
    """Write a PNG.

    Args:
        path: the file; its folder exists.
        pixels: integers of `bits` bits as they are; or floats 0..1, clipped, NaN as 0. [H, W] or [H, W, 1, 3 or 4]
        bits: 8 or 16.

    Raises:
        UserError: the file cannot be written.
    """
    kind = f"uint{bits}"
    if pixels.dtype != kind:
        pixels = (np.clip(np.nan_to_num(pixels), 0, 1) * (2**bits - 1) + 0.5).astype(kind)
    pixels = pixels if pixels.ndim > 2 else pixels[..., None]
    names = {1: ["Y"], 3: ["R", "G", "B"], 4: ["R", "G", "B", "A"]}[pixels.shape[2]]
    write_pixels(Path(path), np.ascontiguousarray(pixels), kind, names, {"oiio:UnassociatedAlpha": 1})


def read_mask(path: str | Path) -> np.ndarray:
    """Read an object mask of our own.

    Args:
        path: an 8-bit image.

    Returns:
        True where the first channel is above 127. [H, W]

    Raises:
        UserError: the file is missing, truncated or corrupt.
    """
    return read_image(path)[..., 0] > 127.5 / 255.0


def write_mask(path: str | Path, mask: np.ndarray) -> None:
    """Write an object mask as an 8-bit PNG of 0 and 255.

    Args:
        path: the file; its folder exists.
        mask: True inside. [H, W]

    Raises:
        UserError: the file cannot be written.
    """
    write_png(path, np.asarray(mask, np.uint8) * np.uint8(255))


def srgb_encode(linear: np.ndarray) -> np.ndarray:
    """Put the sRGB transfer curve on (IEC 61966-2-1).

    Args:
        linear: clipped to 0..1. [...]

    Returns:
        Encoded values 0..1, float32. [...]
    """
    x = np.clip(linear, 0.0, 1.0)
    return np.where(x <= 0.0031308, 12.92 * x, 1.055 * x ** (1 / 2.4) - 0.055).astype(np.float32)


def srgb_decode(encoded: np.ndarray) -> np.ndarray:
    """Take the sRGB transfer curve off (IEC 61966-2-1).

    Args:
        encoded: 0..1; more goes on along the curve, negative values along its linear foot. [...]

    Returns:
        Linear values, float32. [...]
    """
    x = np.asarray(encoded, np.float32)
    return np.where(x <= 0.04045, x / 12.92, ((np.maximum(x, 0) + 0.055) / 1.055) ** 2.4).astype(np.float32)
