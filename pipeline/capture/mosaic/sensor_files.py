"""Bare sensor files: reading them, and telling a polariser mosaic from a grey picture, quad-Bayer from monochrome."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pipeline.capture.config import CaptureConfig, MosaicConfig
from pipeline.capture.naming.files import RAW_SUFFIXES
from pipeline.capture.naming.grouping import Group, group_files
from pipeline.capture.pixels.brackets import read_exposures
from pipeline.capture.pixels.linear_image import LinearImage
from pipeline.errors import UserError
from pipeline.formats.image_parts import without_alpha
from pipeline.formats.images import channel_names, open_image


def read_mosaic(group: Group, config: CaptureConfig) -> LinearImage:
    """The bare mosaic [H, W, 1] of one view (and its alpha), brackets merged; equal channels are one. Raises UserError on
    others."""
    path = group.paths[0]
    image = read_exposures(group.angles[None], config.radiometry, sensor_data=True, view=group.view)
    colours = image.colours
    if not all(np.array_equal(image.pixels[..., colours[0]], image.pixels[..., i]) for i in colours[1:]):
        fault = f"has {len(colours)} channels that differ ({', '.join(image.names)}): it holds no polariser mosaic"
        raise UserError(path, fault, "give the sensor's own single-channel file, or move it away")
    alpha = [i for i in range(len(image.names)) if i not in colours]
    image.pixels = np.ascontiguousarray(image.pixels[..., colours[:1] + alpha])
    image.names = ("Y", *("A" for _ in alpha))
    return image


def refuse_colour(paths: Sequence[Path], config: CaptureConfig) -> None:
    """Raise UserError naming a file of several different channels among files that are specified, or seen, to be mosaics."""
    for path in paths:
        if path.suffix.lower() in RAW_SUFFIXES or single_plane(path):
            continue
        differ = f"has channels {', '.join(channel_names(path, plain=True))} that differ, but"
        remedy = "save the sensor's bare samples as one channel"
        if config.mosaic == MosaicConfig() and config.layout != "mosaic":
            raise UserError(path, f"{differ} the other images are polariser mosaics", f"{remedy}, or move it away")
        stated_by = "[mosaic] in capture.toml" if config.mosaic != MosaicConfig() else 'layout = "mosaic"'
        raise UserError(path, f"{differ} {stated_by} says that it is a mosaic", f"{remedy}, or take that out of capture.toml")


def single_plane(path: Path) -> bool:
    """Whether an image file holds one plane: a single channel (beside alpha), or colours that are equal everywhere."""
    colours = len(without_alpha(channel_names(path, plain=True)))
    if colours != 3:
        return colours == 1
    image = open_image(path, unassociated=True)
    spec = image.spec()
    try:
        for rows in (min(SKIMMED, spec.height), spec.height):  # a colour picture's first rows tell already
            band = image.read_scanlines(0, 0, spec.y, spec.y + rows, 0, 0, spec.nchannels, "float")
            if band is None and (band := image.read_image("float")) is None:
                raise UserError(path, "the image is truncated or corrupt", "copy it again from its source")
            pixels = np.asarray(band).reshape(-1, spec.nchannels)
            if not ((pixels[:, 0] == pixels[:, 1]) & (pixels[:, 1] == pixels[:, 2])).all():
                return False
    finally:
        image.close()
    return True


SKIMMED = 32


def mosaic_colour(paths: Sequence[Path], config: CaptureConfig) -> str:
    """ "bayer" where the 2x2 blocks of mosaics alternate as colours do, else "mono"."""
    shares = []
    for path in _a_few(paths):
        samples = _bare(path, config)
        h, w = samples.shape[0] // 2 * 2, samples.shape[1] // 2 * 2
        blocks = samples[:h, :w].reshape(h // 2, 2, w // 2, 2).mean((1, 3))
        shares.append(carrier_share(blocks, period=2))
    return "bayer" if float(np.mean(shares)) > COLOUR_SHARE else "mono"


def _a_few(paths: Sequence[Path]) -> list[Path]:
    return list(paths)[:: max(1, len(paths) // LOOKED_AT)][:LOOKED_AT]


LOOKED_AT = 4


def carriers_seen(paths: Sequence[Path], config: CaptureConfig) -> float:
    """Mean share of lit tiles that show a 2x2 polariser pattern, over a few of the files. Raises UserError."""
    return float(np.mean([carrier_share(_bare(path, config), period=4) for path in _a_few(paths)]))


def _bare(path: Path, config: CaptureConfig) -> NDArray[np.float32]:
    group = group_files([path], path.parent, config, stacks=False)[0]
    return read_mosaic(group, config).pixels[..., 0]


CARRIER_SHARE = 0.04
"""Of the lit tiles that must show the pattern: measured 0.12 to 0.32 on mosaics of small objects, 0.005 at most on their
grey pictures, 0.003 on textured photographs that were demosaiced themselves."""
COLOUR_SHARE = 0.03
"""The same for colours, which grey parts do not show: 0.07 to 0.29 on average, 0.00 on monochrome mosaics."""
TILE = 4
SURE = 6.0


def carrier_share(samples: NDArray[np.float32], period: int) -> float:
    """Share of lit tiles in which odd and even columns (or rows) differ steadily by more than content explains.

    Per 2x2 block the step from its first to its second sample, less the slope over `period` on either side (a multiple
    of the colours' period, so that colours do not enter), is averaged over tiles of 4x4 blocks and held against its own
    scatter.
    """
    share = 0.0
    for image in (samples, samples.T):
        span = 2 * period
        height, width = image.shape[0] // 2 * 2, (image.shape[1] - span) // 2 * 2
        if height < 2 * TILE or width < 2 * TILE:
            continue
        here = image[:height, period : period + width]
        before, after = here - image[:height, :width], image[:height, span : span + width] - here
        slope = np.where(np.abs(before) < np.abs(after), before, after) / period  # the smoother side: edges are one-sided
        step = (np.roll(here, -1, axis=1) - here - slope)[:, ::2]
        step = (step[::2] + step[1::2]) / 2 if period == 4 else step[: height // 2 * 2]
        rows, columns = step.shape[0] // TILE * TILE, step.shape[1] // TILE * TILE
        tiles = step[:rows, :columns].reshape(rows // TILE, TILE, -1, TILE).swapaxes(1, 2).reshape(-1, TILE * TILE)
        level = here[:: here.shape[0] // step.shape[0], ::2][:rows, :columns]
        bright = level.reshape(rows // TILE, TILE, -1, TILE).mean((1, 3)).ravel()
        lit = bright > 0.05 * np.percentile(bright, 99)
        if lit.sum() < 4:
            continue
        z = np.abs(tiles.mean(1)) * TILE / (tiles.std(1) + 1e-9)
        share = max(share, float((z[lit] > SURE).mean()))
    return share
