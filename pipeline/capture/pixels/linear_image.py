"""What every reader of image files returns."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pipeline.capture.config import RadiometryConfig
from pipeline.errors import UserError
from pipeline.formats.exr_frame import ExrFrame
from pipeline.formats.image_parts import without_alpha


def balance(light: NDArray[np.float32], radiometry: RadiometryConfig) -> None:
    """capture.toml's white balance on light [..., 3 rgb], in place."""
    if radiometry.white_balance:
        light *= np.asarray(radiometry.white_balance, np.float32)


NO_LIGHT = frozenset({"a", "z", "zback", "depth", "id", "mask"})
"""Names, lower case, of a lone channel that is no picture."""


@dataclass
class LinearImage:
    """Linear pixels [H, W, C] float32 with their channel names; saturated [H, W]; orientation is EXIF's (1 upright);
    frame: of an EXR, what became of its windows and primaries; doubt: what does not fit, of several exposures."""

    pixels: NDArray[np.float32]
    names: tuple[str, ...]
    saturated: NDArray[np.bool_]
    bits: int
    orientation: int = 1
    exposure_s: float | None = None
    encoding: str = "linear"
    frame: ExrFrame | None = None
    doubt: str | None = None

    @property
    def colours(self) -> list[int]:
        """Which channels hold light: all but alpha."""
        return without_alpha(self.names)

    def channels(self, wanted: Sequence[str], path: Path) -> NDArray[np.float32]:
        """The named channels [H, W, len(wanted)], case ignored. Raises UserError naming what the file has."""
        lower = [name.lower() for name in self.names]
        missing = [name for name in wanted if name.lower() not in lower]
        if missing:
            raise UserError(
                path, f"no channel {', '.join(missing)} (it has {', '.join(self.names)})", "export it with these channels"
            )
        index = [lower.index(name.lower()) for name in wanted]
        if index == list(range(index[0], index[0] + len(index))):
            return self.pixels[..., index[0] : index[0] + len(index)]
        return self.pixels[..., index]

    def rgb(self, path: Path) -> NDArray[np.float32]:
        """Colour [H, W, 3]; a single channel is grey."""
        lower = [name.lower() for name in self.names]
        if all(name in lower for name in "rgb"):
            return self.channels(("R", "G", "B"), path)
        grey = [name for name in self.names if name.lower() in ("y", "l", "i", "gray", "luminance")]
        if grey or (len(self.names) == 1 and lower[0] not in NO_LIGHT):
            return np.repeat(self.channels((grey or [self.names[0]])[:1], path), 3, axis=-1)
        raise UserError(path, f"no colour channels (it has {', '.join(self.names)})", "export R, G, B or S0.R .. S2.B")

    @property
    def alpha(self) -> NDArray[np.float32] | None:
        """The alpha channel [H, W], or None."""
        lower = [name.lower() for name in self.names]
        return self.pixels[..., lower.index("a")] if "a" in lower else None
