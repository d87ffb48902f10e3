"""The codes of a capture's 16-bit files, and the white level that they tell."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from pipeline.capture.naming.grouping import Exposure
from pipeline.capture.radiometry.code_range import bits_used, code_range, low_codes, moved_up, some_of
from pipeline.formats.image_parts import without_alpha
from pipeline.formats.images import open_image


def codes_of(files: Sequence[Exposure]) -> list[NDArray[np.uint16]]:
    """Codes of some of the 16-bit `files`, without alpha; none where capture.toml tells their format ([raw])."""

    def codes(e: Exposure) -> NDArray[np.uint16]:
        image = open_image(e.path, e.page, unassociated=True)
        spec = image.spec()
        pixels = image.read_image("uint16")
        image.close()
        if pixels is None:
            return np.zeros(0, np.uint16)  # its reader says what is wrong
        colour = without_alpha(spec.channelnames)
        return np.asarray(pixels).reshape(-1, spec.nchannels)[:, colour].astype(np.uint16, copy=False)

    first = open_image(files[0].path, files[0].page)
    own = getattr(first, "white_level", None)
    size = first.spec().width * first.spec().height * first.spec().nchannels
    first.close()
    return [] if own is not None else [codes(e) for e in some_of(list(dict.fromkeys(files)), size)]


def white_level(files: Sequence[Exposure], samples: Sequence[NDArray[np.uint16]]) -> tuple[float | None, list[str], list[str]]:
    """The code that full samples have in 16-bit `files`, where fewer bits are in use (else None), with warnings and facts."""
    first = open_image(files[0].path, files[0].page)
    own = getattr(first, "white_level", None)
    first.close()
    if own is not None:
        return own, [], []  # set by raw.format
    found = code_range(samples)
    if found is None:
        used = bits_used(samples)
        return moved_up(used), *low_codes(used, files[0].path)
    line = (
        f"{files[0].path}: codes of these 16-bit files end at {found.white_level:g}, which {found.clipped} samples have: they "
        f"are taken as {found.bits}-bit codes, clipped there; say so in capture.toml: "
        f"radiometry.white_level = {found.white_level:g}"
    )
    return found.white_level, [line], []
