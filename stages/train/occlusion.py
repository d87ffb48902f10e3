"""Self-occlusion of the model: what shading needs of it, per view."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import torch


@dataclass(frozen=True)
class ViewOcclusion:
    """Visibility and indirect light at a view's counting pixels, as `pipeline.lighting.shade` takes them."""

    visibility: torch.Tensor
    indirect: torch.Tensor | None

    def arguments(self) -> dict[str, Any]:
        """Keyword arguments for `shade`."""
        return {"visibility": self.visibility, "indirect": self.indirect}
