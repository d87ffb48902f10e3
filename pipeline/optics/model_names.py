"""Names of the reflectance models that users choose between; each stands here alone, for the options and for the shading."""

from __future__ import annotations

from typing import Literal, get_args

Fresnel = Literal["exact", "schlick"]
FRESNELS: tuple[Fresnel, ...] = get_args(Fresnel)
Distribution = Literal["ggx", "beckmann"]
"""Of the facets' normals."""
DISTRIBUTIONS: tuple[Distribution, ...] = get_args(Distribution)
Mirror = Literal["split", "tree-coarse", "tree", "tree-fine", "lobe-4", "lobe-12", "lobe-24", "lobe-48"]
TREES = {"tree-coarse": 0.6, "tree": 0.45, "tree-fine": 0.3}
"""Share of the lobe's own scale that a node of the tree of light may span (half its diagonal, as a turn of the half vector):
the error falls with its square, the nodes grow with its inverse square. See `pipeline.shading.light_tree`."""
MIRRORS: dict[str, tuple[int, int] | None] = {
    "split": None, **dict.fromkeys(TREES), "lobe-4": (1, 4), "lobe-12": (2, 6), "lobe-24": (3, 8), "lobe-48": (4, 12)
}  # fmt: skip
"""Rings x azimuths of the facets over which mirrored light is summed (`pipeline.shading.lobe`); None is the split sum, or a
tree."""
Indirect = Literal["traced", "gridmap", "sh", "none"]
"""How light that an object hides from itself and sends to itself is found: rays at its surface; PhyGaP's local environments
(`pipeline.shading.gridmap`); spherical harmonics learnt for every Gaussian, as in Ref-Gaussian; or not at all."""
AnchorWeights = Literal["inverse-square", "printed"]
"""Of GridMap's anchors: 1/d^2, the authors' program's; d, as Eq. 9 prints it, which favours the farthest anchors."""
ANCHOR_WEIGHTS: tuple[AnchorWeights, ...] = get_args(AnchorWeights)
AnchorPlaces = Literal["box", "surface"]
"""Of GridMap's anchors: the bounding box, or close to the surface (PhyGaP 10.4)."""
ANCHOR_PLACES: tuple[AnchorPlaces, ...] = get_args(AnchorPlaces)
