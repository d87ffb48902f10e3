"""What an EXR's header says of its pixels' place and colours: data window in display window, primaries.

The picture is the display window; pixels that the file does not hold are black, those beyond it are no part of it, as every
compositor has it. Colours of other primaries become linear Rec. 709 (sRGB's).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import UserError

REC709 = (0.64, 0.33, 0.30, 0.60, 0.15, 0.06, 0.3127, 0.3290)
"""Chromaticities (x, y) of red, green, blue and white: what an EXR without any means (OpenEXR's default)."""
SAME = 2e-3
"""Of a chromaticity: files round to three digits or less."""
LARGEST = 1 << 28
"""Pixels of a display window: no camera's."""
BRADFORD = np.array([[0.8951, 0.2664, -0.1614], [-0.7502, 1.7135, 0.0367], [0.0389, -0.0685, 1.0296]])
"""XYZ to the cone responses in which whites are scaled (Lam 1985; ICC.1:2010, annex E)."""


@dataclass(frozen=True)
class ExrFrame:
    """What an EXR's header says of where its pixels lie and of their colours.

    Fields:
        size: of the picture, its display window: width, height in pixels.
        corner: x, y of the first stored pixel in the picture; negative where it lies outside.
        stored: width, height of the stored pixels, the data window.
        colour: takes stored linear RGB to Rec. 709; None: it is Rec. 709 already. [3, 3]
    """

    size: tuple[int, int]
    corner: tuple[int, int]
    stored: tuple[int, int]
    colour: NDArray[np.float32] | None

    @property
    def is_plain(self) -> bool:
        """Whether the pixels as stored are the picture."""
        return self.size == self.stored and self.corner == (0, 0) and self.colour is None

    def part(self, start: int, stop: int) -> tuple[slice, slice, slice, slice]:
        """Of the picture's rows start..stop: which stored rows (from 0) and columns lie there, and where (rows from start)."""
        (x, y), (w, h), (width, _) = self.corner, self.stored, self.size
        top, bottom = max(start, y), max(max(start, y), min(stop, y + h))
        left, right = max(0, x), max(max(0, x), min(width, x + w))
        return (slice(top - y, bottom - y), slice(left - x, right - x), slice(top - start, bottom - start), slice(left, right))

    def picture(self, pixels: NDArray[Any], names: Sequence[str]) -> NDArray[Any]:
        """The picture [H, W, C] of stored pixels [h, w, C], float."""
        if self.is_plain:
            return pixels
        out = np.zeros((self.size[1], self.size[0], pixels.shape[2]), pixels.dtype)
        rows, columns, down, across = self.part(0, self.size[1])
        out[down, across] = pixels[rows, columns]
        return self.recoloured(out, names)

    def recoloured(self, pixels: NDArray[Any], names: Sequence[str]) -> NDArray[Any]:
        """Pixels [..., C] with every triple of channels R, G, B (S0.R, S0.G, S0.B, ...) in Rec. 709, in place."""
        if self.colour is not None:
            for triple in colour_triples(names):
                pixels[..., triple] = pixels[..., triple] @ self.colour.T
        return pixels


def exr_frame(spec: Any, path: Path) -> ExrFrame:
    """Read from an image's header where its pixels lie and what its primaries are.

    Args:
        spec: OpenImageIO's ImageSpec of the open file.
        path: the file, for its suffix and for errors.

    Returns:
        The frame; of a file that is no EXR, one that changes nothing.

    Raises:
        UserError: the display window is empty or absurdly large, or the stored pixels all lie outside it.
    """
    stored = (spec.width, spec.height)
    if path.suffix.lower() != ".exr":
        return ExrFrame(stored, (0, 0), stored, None)
    size, corner = (spec.full_width, spec.full_height), (spec.x - spec.full_x, spec.y - spec.full_y)
    if size != stored or corner != (0, 0):
        if min(size) <= 0 or size[0] * size[1] > LARGEST:
            raise UserError(path, f"its display window is {size[0]}x{size[1]}", "export it again")
        if any(c >= n or c + k <= 0 for c, n, k in zip(corner, size, stored)):
            raise UserError(path, "its data window lies outside its display window", "export it again without cropping")
    return ExrFrame(size, corner, stored, to_rec709(spec.getattribute("chromaticities")))


def to_rec709(chromaticities: Sequence[float] | None) -> NDArray[np.float32] | None:
    """Linear RGB of these primaries to Rec. 709 [3, 3], whites on each other (Bradford); None where they are the same."""
    if chromaticities is None or len(chromaticities) != 8 or not np.isfinite(chromaticities).all():
        return None
    if np.abs(np.subtract(chromaticities, REC709)).max() < SAME:
        return None
    theirs, ours = (_xyz_from_rgb(c) for c in (chromaticities, REC709))
    if theirs is None or ours is None:
        return None
    whites = [BRADFORD @ m.sum(1) for m in (theirs, ours)]
    adapted = np.linalg.inv(BRADFORD) @ np.diag(whites[1] / whites[0]) @ BRADFORD
    return np.asarray(np.linalg.inv(ours) @ adapted @ theirs, np.float32)


def _xyz_from_rgb(chromaticities: Sequence[float]) -> NDArray[np.float64] | None:
    """CIE XYZ (white's Y = 1) of linear RGB [3, 3]; None where the primaries lie on a line or white has no luminance."""
    points = np.array([(x, y, 1 - x - y) for x, y in zip(chromaticities[::2], chromaticities[1::2])])
    if abs(np.linalg.det(points[:3])) < 1e-6 or points[3, 1] <= 0:
        return None
    return np.asarray(points[:3].T * np.linalg.solve(points[:3].T, points[3] / points[3, 1]))


def colour_triples(names: Sequence[str]) -> list[list[int]]:
    """Indices of the channels R, G, B of every layer that has all three."""
    at = {name.lower(): i for i, name in enumerate(names)}
    layers = [name[:-1] for name in at if name.endswith("r") and (len(name) == 1 or name[-2] == ".")]
    return [[at[f"{layer}{c}"] for c in "rgb"] for layer in layers if all(f"{layer}{c}" in at for c in "rgb")]


PRIMARIES = "its colours have primaries of their own: converted to Rec. 709; check the header's chromaticities"


def primaries_remark(frame: ExrFrame | None) -> dict[str, int]:
    """Remark on a file whose colours were converted to Rec. 709.

    Args:
        frame: of the file; None: not an EXR.

    Returns:
        An entry for `DecodedView.faults`, fault to pixels (0: none are lost); empty where nothing was converted.
    """
    return {} if frame is None or frame.colour is None else {PRIMARIES: 0}
