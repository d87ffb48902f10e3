"""Self-occlusion and inter-reflection by precomputed transfer at the vertices of the object's own mesh.

Rays from every vertex to the texels of a coarse cube tell once which light arrives and where the rest comes from.
After that any environment costs two matrix products: the share of irradiance that arrives (`shadow`), and the light
from the object's own surface (`bounced`), whose radiance is albedo/pi times its own irradiance, one or more times over.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.sparse import csr_matrix

from pipeline.optics import fresnel, sphere

from .cube import cube_directions
from .kernels import REFERENCE_IOR
from .occluder import Occluder, tangent_frames
from .prefilter import pyramid, pyramid_sizes
from .shading import Occlusion
from .splitsum import half_vectors
from .symmetry import torch_csr

# Rays cast at a time: bounds the memory at about 300 MB.
BLOCK = 4_000_000


@dataclass(frozen=True)
class SurfaceLight:
    """Light at the mesh's vertices under one environment, all [V, 3].

    shadow, bounced: as in `shading.Occlusion`; leaving: diffuse radiance that the surface sends back.
    """

    shadow: torch.Tensor
    bounced: torch.Tensor
    leaving: torch.Tensor


@dataclass(frozen=True)
class Attachment:
    """P shaded points tied to a mesh: what `Transfer.occlusion` needs of them, whatever the environment."""

    vertices: torch.Tensor  # [P, 3] corners of the nearest triangle
    weights: torch.Tensor  # [P, 3] of the nearest point in it
    unblocked: torch.Tensor  # [P] share of the mirror rays that leave
    mirrored: torch.Tensor  # sparse [P, V]: where the other rays end, summing to 1 - unblocked


class Transfer:
    """Visibility of a cube of `resolution` from every vertex of an occluder, and the vertices that block it.

    albedo [V, 3] of the mesh, linear; ior: one value, for how much light passes in and out of the surface.
    """

    def __init__(self, occluder: Occluder, albedo: NDArray, *, ior: float = REFERENCE_IOR, resolution: int = 8) -> None:
        self.occluder, self.resolution = occluder, resolution
        self.albedo = torch.as_tensor(np.asarray(albedo), dtype=torch.float32)
        # Received light is weighted by the way in at the reference IoR: scaled to this one, times the mean way out.
        entering = float(fresnel.hemispherical_transmittance(np.asarray(ior)))
        self._leaving = entering * entering / float(fresnel.hemispherical_transmittance(np.asarray(REFERENCE_IOR)))
        self._weights, self._blocked, self._meets = self._cast()

    def _cast(self) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """Weights of texels at vertices [V, K], those of blocked texels [V, K], those of the vertices met [V, V]."""
        mesh = self.occluder
        directions = cube_directions(self.resolution).reshape(-1, 3).astype(np.float32)
        area = np.tile(sphere.cube_solid_angles(self.resolution).ravel(), 6).astype(np.float32)
        count, texels = len(mesh.vertices), len(directions)
        cosine = np.maximum(mesh.normals @ directions.T, 0).astype(np.float32)
        weights = cosine * fresnel.transmittance(cosine, np.float32(REFERENCE_IOR)) * area
        found = []
        step = max(1, BLOCK // texels)
        for start in range(0, count, step):
            vertex, texel = np.nonzero(cosine[start : start + step])
            vertex += start
            hits = mesh.cast(mesh.vertices[vertex] + mesh.lift * mesh.normals[vertex], directions[texel])
            vertex, texel = vertex[hits.blocked], texel[hits.blocked]
            found.append((vertex, texel, hits.vertices[hits.blocked], hits.weights[hits.blocked]))
        vertex, texel, corners, share = (np.concatenate(x) for x in zip(*found))
        w = weights[vertex, texel]
        blocked = csr_matrix((w, (vertex, texel)), shape=(count, texels))
        met = (w[:, None] * share).ravel(), (np.repeat(vertex, 3), corners.ravel())
        return torch.as_tensor(weights), torch_csr(blocked), torch_csr(csr_matrix(met, shape=(count, count)))

    def light(self, radiance: torch.Tensor, bounces: int = 2) -> SurfaceLight:
        """Light at the vertices under radiance [6, R, R, 3] (R at least the transfer's resolution); differentiable."""
        texels = self._texels(radiance)
        arriving = self._weights @ texels
        # The floor meets a black environment: nothing arrives, and a shadow of nothing is 1.
        shadow = 1 - (self._blocked @ texels) / arriving.clamp_min(torch.finfo(arriving.dtype).tiny)
        direct = shadow * arriving
        scale = self._leaving / torch.pi
        bounced = torch.zeros_like(direct)
        for _ in range(bounces):
            bounced = self._meets @ (scale * self.albedo * (direct + bounced))
        return SurfaceLight(shadow, bounced, scale * self.albedo * (direct + bounced))

    def _texels(self, radiance: torch.Tensor) -> torch.Tensor:
        sizes = pyramid_sizes(radiance.shape[1])
        if self.resolution not in sizes:
            raise ValueError(f"environment of {radiance.shape[1]} texels has no level of {self.resolution}")
        start = sum(6 * n * n for n in sizes[: sizes.index(self.resolution)])
        return pyramid(radiance)[start : start + 6 * self.resolution**2]

    def attach(
        self,
        points: NDArray,  # [P, 3] world, on or near the mesh
        normals: NDArray,  # [P, 3] unit
        view: NDArray,  # [P, 3] unit, towards the camera
        roughness: NDArray,  # [P]
        rays: tuple[int, int] = (1, 4),
        lobe: str = "ggx",
    ) -> Attachment:
        """Tie shaded points to the mesh and cast their mirror rays: `rays` = (rings, azimuths) over the lobe."""
        mesh = self.occluder
        near = mesh.nearest(points)
        tan, azimuth, share = half_vectors(1.0, lobe, rays[0], 2 * rays[1])
        azimuth = azimuth[::2] * 2
        tan = tan[:, None] * (np.asarray(roughness) ** 2)[:, None, None]
        nh = 1 / np.sqrt(1 + tan * tan)
        local = np.stack(np.broadcast_arrays(tan * nh * np.cos(azimuth), tan * nh * np.sin(azimuth), nh), axis=-1).reshape(
            len(points), -1, 3
        )
        h = np.einsum("pka,pab->pkb", local, tangent_frames(normals))
        out = 2 * (h * view[:, None]).sum(-1, keepdims=True) * h - view[:, None]
        # Directions below the surface are the mesh's business no more than the lobe's: leave them out.
        weight = np.repeat(share / rays[1], rays[1]) * ((out * normals[:, None]).sum(-1) > 0)
        weight = (weight / np.maximum(weight.sum(1, keepdims=True), 1e-6)).astype(np.float32)
        origins = np.broadcast_to((points + mesh.lift * normals)[:, None], out.shape)
        hits = mesh.cast(origins.reshape(-1, 3), out.reshape(-1, 3))
        blocked = hits.blocked.reshape(weight.shape)
        point, _ = np.nonzero(blocked)
        values = (weight[blocked][:, None] * hits.weights[hits.blocked]).ravel()
        met = csr_matrix(
            (values.astype(np.float32), (np.repeat(point, 3), hits.vertices[hits.blocked].ravel())),
            shape=(len(points), len(mesh.vertices)),
        )
        return Attachment(
            torch.as_tensor(near.vertices),
            torch.as_tensor(near.weights),
            torch.as_tensor(1 - (weight * blocked).sum(1)),
            torch_csr(met),
        )

    @staticmethod
    def occlusion(attachment: Attachment, light: SurfaceLight) -> Occlusion:
        """What `shade` needs at attached points."""
        at = attachment.vertices
        w = attachment.weights[..., None]
        return Occlusion(
            shadow=(light.shadow[at] * w).sum(1),
            bounced=(light.bounced[at] * w).sum(1),
            unblocked=attachment.unblocked,
            seen=attachment.mirrored @ light.leaving,
        )
