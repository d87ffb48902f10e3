"""Files that are an angle stack by themselves: TIFF pages, planes of an array, EXR parts or channels behind a polariser."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pipeline.capture.config import CaptureConfig
from pipeline.capture.naming.grouping import ANGLE_ALONE, are_angles, turned
from pipeline.errors import UserError
from pipeline.formats.bare_arrays import ARRAY_SUFFIXES
from pipeline.formats.image_parts import MAY_HOLD_SEVERAL, SPLIT, Page, layers, pages_of
from pipeline.formats.images import open_image, open_whole, srgb_decode

USUAL = (0.0, 45.0, 90.0, 135.0)
"""Degrees of four pages in their order, as polarisation cameras' viewers save them."""
FOUR_PLANES = frozenset({".tif", ".tiff", ".png", ".exr", ".npy", ".bmp", ".tga", ".webp"})
BALANCED = 0.02
"""Median of |I0 + I90 - I45 - I135| over their sum below which four channels are four angles: renders with 8 bits reach 0.003
and hand-turned filters 0.01; of a colour picture with an alpha channel it is 0.1 and more."""


def paged(paths: Sequence[Path], config: CaptureConfig) -> dict[Path, dict[float, Page]]:
    """Which of these files are angle stacks by themselves, and their pages by angle. Raises UserError where only some are."""
    if not paths:
        return {}
    in_colour = bool(angle_pages(paths[0], config, look=True))  # pixels of one file tell whether to look at the others'
    found = {path: pages for path in paths if (pages := angle_pages(path, config, look=in_colour))}
    if found and len(found) < len(paths):
        odd = next(path for path in paths if path not in found)
        raise UserError(odd, f"holds one image while {len(found)} other files hold one a polariser angle", "save all alike")
    return found


def angle_pages(path: Path, config: CaptureConfig, look: bool = True) -> dict[float, Page] | None:
    """The images behind each angle (degrees, ours) within one file, or None where it holds one image.

    `[stack.angles_deg]` names them by page number from 1, by title or by channel; channels and parts called like angles tell
    them; four pages of one size are 0, 45, 90 and 135 degrees; `look`: four channels are, where their pixels say so.
    Raises UserError on pages whose angles are not known.
    """
    if path.suffix.lower() not in MAY_HOLD_SEVERAL | ARRAY_SUFFIXES | FOUR_PLANES:
        return None
    pages = _pages(path)
    if len(pages) == 1:
        found = _by_channel(pages[0], config)
        return found or (_four_in_colour(path, pages[0]) if look and pages[0].names == ("R", "G", "B", "A") else None)
    found = _known(pages, config) or _by_title(pages)
    if found is not None or path.suffix.lower() == ".exr":
        return found
    if len(pages) == 4 and len({page.names for page in pages}) == 1:
        return {turned(angle, config): _as_picture(page) for angle, page in zip(USUAL, pages)}
    raise UserError(
        path, f"holds {len(pages)} images", f'{SPLIT}, or set stack.angles_deg by their numbers ("1" = 0, "2" = 60, ...)'
    )


def _pages(path: Path) -> list[Page]:
    image = open_whole(path)
    pages = pages_of(image, path)
    grey = path.suffix.lower() in (".tif", ".tiff") and image.spec().get_int_attribute("tiff:PhotometricInterpretation", 2) < 2
    image.close()
    if grey and len(pages) == 1 and len(pages[0].names) == 4:  # four samples, none of them a colour
        return [Page(0, (k,), ("Y",), "") for k in range(4)]
    return pages


def _as_picture(page: Page) -> Page:
    """The page under the names of a picture: one channel is grey, three and more are colour."""
    count = 3 if len(page.channels) >= 3 else 1
    return Page(page.subimage, page.channels[:count], ("Y",) if count == 1 else ("R", "G", "B"), page.title)


def _known(pages: Sequence[Page], config: CaptureConfig) -> dict[float, Page] | None:
    """By `[stack.angles_deg]`, whose names are page numbers from 1 or titles."""
    known = config.stack.angles_deg
    named = {str(k): page for k, page in enumerate(pages, 1)} | {page.title: page for page in pages if page.title}
    if not known or not set(known) <= set(named):
        return None
    return {turned(angle, config): _as_picture(named[name]) for name, angle in known.items()}


def _by_title(pages: Sequence[Page]) -> dict[float, Page] | None:
    """By titles that are angles."""
    matches = [ANGLE_ALONE.match(page.title.rpartition(".")[2]) for page in pages]
    angles = [float(m["angle"]) for m in matches if m]
    if len(angles) < len(pages) or not are_angles(angles):
        return None
    return {angle: _as_picture(page) for angle, page in sorted(zip(angles, pages), key=lambda pair: pair[0])}


def _by_channel(page: Page, config: CaptureConfig) -> dict[float, Page] | None:
    """By channels or layers that are called like angles (0, I45, 90.R), or that `[stack.angles_deg]` names."""
    known = config.stack.angles_deg
    if len(known) >= 3 and set(known) <= set(page.names):
        places = {name: k for k, name in enumerate(page.names)}
        return {turned(a, config): Page(page.subimage, (page.channels[places[n]],), ("Y",)) for n, a in known.items()}
    found: dict[float, Page] = {}
    inside = layers(page.names)
    singles = {name: {"Y": k} for name, k in inside.pop("", {}).items()}
    for title, channels in {**singles, **inside}.items():
        match = ANGLE_ALONE.match(title.rpartition(".")[2])
        order = [channels[c] for c in ("R", "G", "B") if c in channels] or list(channels.values())[:1]
        if match and len(order) in (1, 3):
            places_ = tuple(page.channels[k] for k in order)
            found[turned(float(match["angle"]), config)] = _as_picture(Page(page.subimage, places_, ("Y",) * len(places_)))
    return dict(sorted(found.items())) if are_angles(found) else None


def _four_in_colour(path: Path, page: Page) -> dict[float, Page] | None:
    """Whether the channels R G B A hold light behind 0, 45, 90 and 135 degrees: only then does R + B equal G + A."""
    image = open_image(path, unassociated=True)
    pixels = image.read_image("float")
    spec = image.spec()
    image.close()
    if pixels is None:
        return None
    four = np.asarray(pixels, np.float32).reshape(-1, 4)
    eight_bits = str(spec.format) == "uint8"
    if not (imbalance(four) < BALANCED or (eight_bits and imbalance(srgb_decode(four)) < BALANCED)):
        return None
    return {angle: Page(page.subimage, (k,), ("Y",)) for k, angle in enumerate(USUAL)}


def imbalance(four: NDArray[np.float32]) -> float:
    """Median |I0 + I90 - I45 - I135| over their sum, of lit pixels [P, 4]; 1 where all of them are alike or too few are lit."""
    total = four.sum(1)
    lit = (total > 0.05 * np.nanpercentile(total, 99)) & (four.max(1) < 1)
    if lit.sum() < 64 or np.percentile(np.ptp(four[lit], axis=1) / total[lit], 95) < BALANCED:
        return 1.0
    some = four[lit]
    return float(np.median(np.abs(some[:, 0] + some[:, 2] - some[:, 1] - some[:, 3]) / total[lit]))
