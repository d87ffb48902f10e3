"""Names of the reflectance models that users choose between; each stands here alone, for the options and for the shading."""

from __future__ import annotations

from typing import Literal, get_args

Fresnel = Literal["exact", "schlick"]
FRESNELS: tuple[Fresnel, ...] = get_args(Fresnel)
Distribution = Literal["ggx", "beckmann"]
"""Of the facets' normals."""
DISTRIBUTIONS: tuple[Distribution, ...] = get_args(Distribution)
Mirror = Literal["split", "lobe-4", "lobe-12", "lobe-24", "lobe-48"]
MIRRORS: dict[str, tuple[int, int] | None] = {
    "split": None, "lobe-4": (1, 4), "lobe-12": (2, 6), "lobe-24": (3, 8), "lobe-48": (4, 12)
}  # fmt: skip
"""Rings x azimuths of the facets over which mirrored light is summed; None is the split sum. See `pipeline.shading.lobe`."""
