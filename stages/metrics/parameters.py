"""Parameters of the metrics stage."""

from __future__ import annotations

from dataclasses import dataclass, field


@dataclass(frozen=True)
class MetricsParameters:
    """What the report shows."""

    mesh_samples: int = field(default=100000, metadata={"help": "points on each surface for the mesh figures (count)"})
    picture_px: int = field(default=288, metadata={"help": "longer side of the report's pictures at most (px)"})
    shown_views: int = field(default=4, metadata={"help": "test views shown in the report at most (count)"})

    def __post_init__(self) -> None:
        if self.mesh_samples < 100:
            raise ValueError("mesh_samples must be at least 100")
        if not 32 <= self.picture_px <= 4096:
            raise ValueError("picture_px must lie between 32 and 4096")
        if self.shown_views < 1:
            raise ValueError("shown_views must be at least 1")
