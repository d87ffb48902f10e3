"""A little polarised hill seen by a camera that barely moves, and writers of files as cameras and their viewers save them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import OpenImageIO as oiio
import tifffile

from pipeline.capture.angle_stack.solve import polariser_design
from pipeline.formats.images import srgb_encode

SIDE = 48
ANGLES = (0, 45, 90, 135)
ORDER = (90, 45, 135, 0)


def stokes(view: int = 0, dolp: float = 0.35, side: int = SIDE) -> np.ndarray:
    """[H, W, 3, 3]: light in 0.1 .. 0.7 that varies smoothly, polarised along the slope of a dome."""
    y, x = (np.mgrid[:side, :side] + 0.5) / side * 2 - 1
    x = x + 0.05 * view
    r = np.minimum(np.hypot(x, y), 1)
    light = 0.3 + 0.2 * np.sin(3 * x + view) * np.cos(2.5 * y) + 0.1 * (1 - r)
    s0 = light[..., None] * np.array([1.0, 0.8, 0.6])
    p, phi = dolp * r**1.5, np.arctan2(-y, x)
    ratio = np.stack([np.ones_like(p), p * np.cos(2 * phi), p * np.sin(2 * phi)], -1)
    return (s0[:, :, None] * ratio[..., None]).astype(np.float32)


def behind(light: np.ndarray, degrees: float) -> np.ndarray:
    """What a camera behind an ideal polariser sees, [H, W, 3]."""
    return np.einsum("k,hwkc->hwc", polariser_design([degrees])[0], light).astype(np.float32)


def mosaic(light: np.ndarray, order=ORDER) -> np.ndarray:
    """A monochrome sensor with a polariser on each pixel, [H, W]."""
    grey = light.mean(-1, keepdims=True)
    out = np.zeros(light.shape[:2], np.float32)
    for k, angle in enumerate(order):
        out[k // 2 :: 2, k % 2 :: 2] = behind(grey, angle)[k // 2 :: 2, k % 2 :: 2, 0]
    return out


def codes(light: np.ndarray, bits: int = 16, srgb: bool = False) -> np.ndarray:
    """Integers of linear or sRGB light in 0..1."""
    value = srgb_encode(light) if srgb else np.clip(light, 0, 1)
    return np.round(value * (2**bits - 1)).astype(np.uint8 if bits == 8 else np.uint16)


def header_of(pixels: np.ndarray) -> oiio.ImageSpec:
    height, width, count = pixels.shape
    return oiio.ImageSpec(width, height, count, {"float16": "half"}.get(str(pixels.dtype), str(pixels.dtype)))


def write(path: Path, pixels: np.ndarray, names: str | None = None, **header: object) -> None:
    """Any file that OpenImageIO writes; `header`: EXIF facts."""
    path.parent.mkdir(parents=True, exist_ok=True)
    pixels = pixels[..., None] if pixels.ndim == 2 else pixels
    spec = header_of(pixels)
    if names:
        spec.channelnames = tuple(names.split())
    for key, value in header.items():
        spec.attribute(key.replace("__", ":"), value)
    out = oiio.ImageOutput.create(str(path))
    assert out.open(str(path), spec) and out.write_image(np.ascontiguousarray(pixels)), out.geterror()
    out.close()


def write_parts(path: Path, parts: dict[str, tuple[np.ndarray, str]], crop: tuple[slice, slice] | None = None) -> None:
    """A file of several images: {title: (pixels, channel names)}; `crop`: rows and columns that an EXR stores of them."""
    path.parent.mkdir(parents=True, exist_ok=True)
    specs = []
    for title, (pixels, names) in parts.items():
        spec = header_of(pixels[crop] if crop else pixels)
        spec.channelnames = tuple(names.split())
        spec.attribute("oiio:subimagename", title)
        if crop:
            spec.y, spec.x = crop[0].start, crop[1].start
            spec.full_height, spec.full_width = pixels.shape[:2]
        specs.append(spec)
    out = oiio.ImageOutput.create(str(path))
    assert out.open(str(path), tuple(specs)) if path.suffix == ".exr" else out.open(str(path), specs[0]), out.geterror()
    for k, (pixels, _) in enumerate(parts.values()):
        assert not k or out.open(str(path), specs[k], "AppendSubimage"), out.geterror()
        out.write_image(np.ascontiguousarray(pixels[crop] if crop else pixels))
    out.close()


def dolp(image: np.ndarray) -> np.ndarray:
    """Degree of polarisation [H, W, 3] of [H, W, 3, 3]."""
    return np.hypot(image[:, :, 1], image[:, :, 2]) / np.maximum(image[:, :, 0], 1e-6)


def raw(path: Path, level: int, seconds: float) -> None:
    """A DNG of one grey level above black, with its exposure time."""
    tags = [(50706, "B", 4, (1, 4, 0, 0)), (271, "s", 0, "Test"), (272, "s", 0, "Camera"), (50708, "s", 0, "Test Camera"),
            (33421, "H", 2, (2, 2)), (33422, "B", 4, (0, 1, 1, 2)), (50714, "H", 1, 64), (50717, "H", 1, 4000),
            (33434, "2I", 1, (int(seconds * 1000), 1000)),
            (50721, "2i", 9, (1, 1, 0, 1, 0, 1, 0, 1, 1, 1, 0, 1, 0, 1, 0, 1, 1, 1)), (50728, "2I", 3, (1,) * 6)]  # fmt: skip
    image = np.full((64, 96), level + 64, np.uint16)
    tifffile.imwrite(path, image, photometric="CFA", compression=None, metadata=None, software=None, extratags=tags)
