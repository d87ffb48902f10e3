"""What a capture's gt/ tells, found by view."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import UserError
from pipeline.formats.backdrop import object_pixels
from pipeline.formats.images import channel_names, image_size, read_image, read_stokes

XYZ, RGB = ("X", "Y", "Z"), ("R", "G", "B")


@dataclass(frozen=True)
class Truth:
    """Ground truth of a multi-view capture; views in sorted order. Everything may be absent."""

    root: Path
    views: tuple[str, ...]

    def find(self, kind: str, view: str, suffix: str = "exr") -> Path | None:
        """gt/KIND/VIEW.exr, or by the view's place in sorted order."""
        for name in (view, f"{self.views.index(view):03d}"):
            path = self.root / "gt" / kind / f"{name}.{suffix}"
            if path.is_file():
                return path
        return None

    def normal(self, view: str) -> NDArray[np.float32] | None:
        """World normals [H, W, 3]."""
        path = self.find("normal", view)
        return None if path is None else read_image(path, XYZ)

    def document(self, name: str) -> dict[str, Any] | None:
        """A JSON file of gt/ (or of the capture's root), None where there is none. Raises UserError if it is broken."""
        for path in (self.root / "gt" / name, self.root / name):
            if path.is_file():
                try:
                    return json.loads(path.read_text())
                except ValueError as error:
                    raise UserError(path, f"is not JSON ({error})", "mend or remove it") from error
        return None

    def polarisers(self) -> dict[str, float] | None:
        """True polariser angles by physical camera (degrees)."""
        table = self.document("polarisers.json")
        if table is not None:
            return {k: float(v) for k, v in table.items()}
        table = self.document("gt_lp.json")
        return None if table is None else {f"lp{i}": float(a) for i, a in enumerate(table["true_angles_deg"])}


@dataclass(frozen=True)
class Target:
    """What a test view should look like: `stokes` [H, W, 3, 3] or `rgb` [H, W, 3], black where nothing is compared.

    inside: wholly covered pixels [H, W]; compared: those that hold the object's light [H, W], all where not told.
    """

    stokes: NDArray[np.float32] | None
    rgb: NDArray[np.float32]
    inside: NDArray[np.bool_] | None
    compared: NDArray[np.bool_]


def read_target(decode: Path, masks: Path | None, view: str) -> Target:
    """A view as decoded, without its background. Raises UserError."""
    path = decode / "frames" / f"{view}.exr"
    stokes = read_stokes(path) if "S1.R" in channel_names(path) else None
    rgb = read_image(path, RGB) if stokes is None else stokes[:, :, 0]
    inside, compared = None, np.ones(rgb.shape[:2], bool)
    mask_path = masks / f"{view}.png" if masks else None
    if mask_path is not None and mask_path.exists() and image_size(mask_path) == image_size(path):
        share = read_image(mask_path)[..., 0]
        inside, compared = share > 0.99, object_pixels(rgb, share > 0)
    rgb = rgb * compared[..., None]
    return Target(None if stokes is None else stokes * compared[..., None, None], rgb, inside, compared)
