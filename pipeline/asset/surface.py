"""The textured surface as files hold it: metres, y up, colours as renderers take them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline.geometry.world import Y_UP_FROM
from pipeline.optics.fresnel import hemispherical_transmittance

from .bake import AtlasMesh, Textured
from .lobes import GGX, ggx_roughness

FLAT = 1e-3
"""Less variation of the reflectance, over its largest, is none."""


@dataclass(frozen=True)
class Asset(AtlasMesh):
    """A textured surface in metres, y up: what every file holds.

    maps: `AtlasMesh`'s; base_color: the albedo as renderers take it; roughness_ggx: for their lobe, where `lobe` is another.
    ior: the median, over what is seen. lobe: whose roughness `roughness` is.
    """

    ior: float
    lobe: str = GGX

    @property
    def roughness_name(self) -> str:
        """The map that renderers take, whose lobe is GGX."""
        return "roughness_ggx" if "roughness_ggx" in self.maps else "roughness"

    def reflectance(self) -> tuple[float, NDArray[np.float32] | None]:
        """The largest index of refraction, and what each texel reflects of what that one does [H, W, 1]; None: all the same."""
        seen = self.maps["coverage"][..., 0] > 0
        specular = np.where(seen[..., None], self.maps["specular"], np.median(self.maps["specular"][seen]))
        most = float(specular.max())
        root = np.sqrt(most)
        share = (specular / most).astype(np.float32) if np.ptp(specular) > FLAT * most else None
        return float((1 + root) / (1 - root)), share


def asset_from_world(up: str, unit_m: float | None) -> NDArray[np.float64]:
    """The transform [4, 4] from a capture's world to an asset's: y up, metres (world units where it is not known)."""
    out = np.eye(4)
    out[:3, :3] = Y_UP_FROM[up] * (unit_m or 1.0)
    return out


def in_metres(surface: Textured, up: str, unit_m: float | None, lobe: str = GGX) -> Asset:
    """The surface as files hold it. `base_color`, if there is none, is albedo times the share of light that enters the body;
    `roughness_ggx` that of the lobe nearest to `lobe`, in which `roughness` was fitted.

    Renderers let light out of the body as 1 - (mirrored share); ours also let it in (`shade`), which over a constant sky is
    `hemispherical_transmittance`: a tenth less at an index of 1.5.
    """
    matrix = asset_from_world(up, unit_m)
    turn = Y_UP_FROM[up]
    seen = surface.maps["coverage"][..., 0] > 0
    maps = dict(surface.maps)
    if "base_color" not in maps:
        entering = hemispherical_transmittance(maps["ior"].astype(np.float64))
        maps["base_color"] = (maps["albedo"] * entering).astype(np.float32)
    if lobe != GGX:
        maps["roughness_ggx"] = ggx_roughness(maps["roughness"], lobe)
    tangent = np.concatenate([surface.tangent[:, :3] @ turn.T, surface.tangent[:, 3:]], 1)
    return Asset(
        surface.position @ matrix[:3, :3].T, surface.normal @ turn.T, tangent, surface.faces, surface.uv, maps,
        float(np.median(surface.maps["ior"][..., 0][seen])), lobe,
    )  # fmt: skip
