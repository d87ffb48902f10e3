"""Parameters of the poses stage."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal


@dataclass(frozen=True)
class PosesParameters:
    """How cameras are found where the capture has none."""

    matching: Literal["auto", "exhaustive", "sequential"] = field(
        default="auto", metadata={"help": "image pairs to match: all, neighbours by name, or all up to 150 views"}
    )
    max_size: int = field(default=1600, metadata={"help": "features are found at this longer side (px)"})
    features: int = field(default=4096, metadata={"help": "features per image at most"})
    focal_px: float | None = field(default=None, metadata={"help": "known focal length, kept (px); none: found"})
    refine_focal: bool = field(default=True, metadata={"help": "refine the focal length where it is not known"})
    rig: Literal["auto", "no"] = field(
        default="auto", metadata={"help": "views of equal name under two cameras form a head with one relative pose"}
    )
    use_masks: bool = field(default=True, metadata={"help": "ignore features outside given masks"})
    triangulate: bool = field(default=False, metadata={"help": "with given cameras: also find sparse points"})
    seed: int = field(default=0, metadata={"help": "of the random choices"})

    def __post_init__(self) -> None:
        """Raises ValueError on values that have no meaning."""
        if self.focal_px is not None and not 0 < self.focal_px < float("inf"):
            raise ValueError(f"focal_px = {self.focal_px} is not above 0")
        if self.max_size < 1 or self.features < 1:
            raise ValueError("max_size and features must be above 0")
