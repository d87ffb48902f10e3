"""Self-occlusion and inter-reflection by precomputed transfer at the vertices of the object's own mesh.

Rays from every vertex to the texels of a coarse cube tell once which light arrives and where the rest comes from.
After that any environment costs two matrix products: the share of irradiance that arrives (`shadow`), and the light
from the object's own surface (`bounced`), whose radiance is albedo/pi times its own irradiance, over and over. What the
interface mirrors counts as sent back evenly too: of a dark body it is half of all that leaves.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.sparse import csr_matrix

from pipeline.geometry.occluder import Occluder, tangent_frames
from pipeline.optics import fresnel, sphere

from .cube import cube_directions
from .prefilter import pyramid, pyramid_sizes
from .prefilter_kernels import REFERENCE_IOR
from .shading import Occlusion
from .splitsum import half_vectors
from .symmetry import torch_csr

# Bounces end where the last adds less than this share of all, which no 8-bit image shows. Half of a white bowl's light comes
# back each time, so that it takes ten.
SETTLED, MOST_BOUNCES = 1e-3, 64
# Rays cast at a time: bounds the memory at about 300 MB.
BLOCK = 4_000_000


@dataclass(frozen=True)
class Gathering:
    """What N points see of a cube of K texels and of the mesh's V vertices around themselves."""

    normals: NDArray[np.float32]  # [N, 3]
    blocked: torch.Tensor  # sparse [N, K]: weights of the texels that the mesh hides
    met: torch.Tensor  # sparse [N, V]: the same weights at the vertices that hide them


@dataclass(frozen=True)
class SurfaceLight:
    """Light at the mesh's vertices under one environment.

    Fields:
        shadow, bounced: as in `shading.Occlusion`. [V, 3]
        leaving: diffuse radiance that the surface sends back. [V, 3]
        texels: the environment that was gathered. [K, 3]
    """

    shadow: torch.Tensor
    bounced: torch.Tensor
    leaving: torch.Tensor
    texels: torch.Tensor


@dataclass(frozen=True)
class Attachment:
    """P shaded points tied to a mesh: what `Transfer.occlusion` needs of them, whatever the environment."""

    vertices: torch.Tensor  # [P, 3] corners of the nearest triangle
    weights: torch.Tensor  # [P, 3] of the nearest point in it
    unblocked: torch.Tensor  # [P] share of the mirror rays that leave
    mirrored: torch.Tensor  # sparse [P, V]: where the other rays end, summing to 1 - unblocked
    gathered: Gathering | None  # the points' own rays, where they were cast


class Transfer:
    """Which part of a cube of light each vertex of an occluder sees, and the vertices that block the rest."""

    def __init__(self, occluder: Occluder, albedo: NDArray, *, ior: float = REFERENCE_IOR, resolution: int = 8) -> None:
        """Cast the rays of all vertices.

        Args:
            occluder: the object's mesh of V vertices.
            albedo: of its vertices, linear RGB. [V, 3]
            ior: of all of it: how much light passes in and out of the surface.
            resolution: texels on a side of the cube's faces.
        """
        self.occluder, self.resolution = occluder, resolution
        self.albedo = torch.as_tensor(np.asarray(albedo), dtype=torch.float32)
        # Received light is weighted by the way in at the reference IoR: scaled to this one, times the mean way out.
        entering = float(fresnel.hemispherical_transmittance(np.asarray(ior)))
        reference = float(fresnel.hemispherical_transmittance(np.asarray(REFERENCE_IOR)))
        self._leaving = (entering * entering * self.albedo + (1 - entering)) / reference
        self._directions = cube_directions(resolution).reshape(-1, 3).astype(np.float32)
        self._areas = np.tile(sphere.cube_solid_angles(resolution).ravel(), 6).astype(np.float32)
        self.vertices = self.gather(occluder.vertices, occluder.normals)

    def _weights(self, normals: NDArray[np.float32]) -> NDArray[np.float32]:
        """T(n.w) (n.w) d omega of the texels [N, K]."""
        cosine = np.maximum(normals @ self._directions.T, 0)
        return cosine * fresnel.transmittance(cosine, np.float32(REFERENCE_IOR)) * self._areas

    def gather(self, points: NDArray, normals: NDArray) -> Gathering:
        """Cast rays from points [N, 3] on the surface with unit normals [N, 3] to all texels above it."""
        mesh, texels = self.occluder, len(self._directions)
        points, normals = np.asarray(points, np.float32), np.asarray(normals, np.float32)
        found = []
        step = max(1, BLOCK // texels)
        for start in range(0, max(1, len(points)), step):
            weights = self._weights(normals[start : start + step])
            point, texel = np.nonzero(weights)
            origins = (points[start : start + step] + mesh.lift * normals[start : start + step])[point]
            hits = mesh.cast(origins, self._directions[texel])
            point, texel, corner = point[hits.blocked], texel[hits.blocked], hits.weights[hits.blocked].argmax(1)
            vertex = np.take_along_axis(hits.vertices[hits.blocked], corner[:, None], 1)[:, 0]
            found.append((point + start, texel, vertex, weights[point, texel]))
        point, texel, vertex, w = (np.concatenate(x) for x in zip(*found))
        blocked = csr_matrix((w, (point, texel)), shape=(len(points), texels))
        met = csr_matrix((w, (point, vertex)), shape=(len(points), len(mesh.vertices)))
        return Gathering(normals, torch_csr(blocked), torch_csr(met))

    def arriving(self, at: Gathering, texels: torch.Tensor) -> torch.Tensor:
        """Irradiance [N, 3] of texels [K, 3] without the mesh."""
        return torch.as_tensor(self._weights(at.normals)) @ texels

    def blocked(self, at: Gathering, texels: torch.Tensor) -> torch.Tensor:
        """Irradiance [N, 3] of texels [K, 3] that the mesh takes."""
        return at.blocked @ texels

    def sees(self, at: Gathering, texels: NDArray[np.int64]) -> NDArray[np.bool_]:
        """Whether each of the points sees each of some texels [N, K']: above its horizon, and nothing in between."""
        hidden = csr_matrix(
            tuple(x.numpy() for x in (at.blocked.values(), at.blocked.col_indices(), at.blocked.crow_indices())),
            shape=tuple(at.blocked.shape),
        )
        return (at.normals @ self._directions[texels].T > 0) & (hidden[:, texels].toarray() == 0)

    def _received(self, at: Gathering, texels: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """(irradiance without the mesh [N, 3], share of it that arrives [N, 3])."""
        arriving = self.arriving(at, texels)
        # The floor meets a black environment: nothing arrives, and a shadow of nothing is 1.
        return arriving, 1 - self.blocked(at, texels) / arriving.clamp_min(torch.finfo(arriving.dtype).tiny)

    def light(self, radiance: torch.Tensor, bounces: int = MOST_BOUNCES) -> SurfaceLight:
        """Light at the vertices under radiance [6, R, R, 3] (R at least the transfer's resolution); differentiable.

        At most `bounces` are followed, and no more once they hardly add anything.
        """
        texels = self._texels(radiance)
        arriving, shadow = self._received(self.vertices, texels)
        return self._spread(shadow, shadow * arriving, texels, bounces)

    def lit(self, direct: torch.Tensor, bounces: int = MOST_BOUNCES) -> SurfaceLight:
        """Light at the vertices that receive `direct` [V, 3] from lamps that are no environment; its `texels` are dark."""
        dark = torch.zeros(len(self._directions), 3)
        return self._spread(torch.ones_like(direct), direct, dark, bounces)

    def _spread(self, shadow: torch.Tensor, direct: torch.Tensor, texels: torch.Tensor, bounces: int) -> SurfaceLight:
        """What the surface sends on to itself of the light that it receives directly [V, 3]."""
        scale = self._leaving / torch.pi
        bounced = torch.zeros_like(direct)
        for _ in range(bounces):
            before, bounced = bounced, self.vertices.met @ (scale * (direct + bounced))
            if float((bounced - before).detach().sum()) <= SETTLED * float((direct + bounced).detach().sum()):
                break
        return SurfaceLight(shadow, bounced, scale * (direct + bounced), texels)

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
        own_rays: bool = False,
    ) -> Attachment:
        """Tie shaded points to the mesh and cast their mirror rays: `rays` = (rings, azimuths) over the lobe.

        own_rays: cast the points' own rays for diffuse light too, instead of interpolating between the vertices.
        """
        mesh = self.occluder
        near = mesh.nearest(points)
        tan, azimuth, share = half_vectors(1.0, lobe, rays[0], 2 * rays[1])
        azimuth = azimuth[::2] * 2
        tan = tan[:, None] * (np.asarray(roughness) ** 2)[:, None, None]
        nh = 1 / np.sqrt(1 + tan * tan)
        local = np.stack(np.broadcast_arrays(tan * nh * np.cos(azimuth), tan * nh * np.sin(azimuth), nh), axis=-1).reshape(
            len(points), rays[0] * rays[1], 3
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
            self.gather(points, normals) if own_rays else None,
        )

    def occlusion(self, attachment: Attachment, light: SurfaceLight) -> Occlusion:
        """What `shade` needs at attached points."""
        seen = attachment.mirrored @ light.leaving
        if attachment.gathered is not None:
            _, shadow = self._received(attachment.gathered, light.texels)
            return Occlusion(shadow, attachment.gathered.met @ light.leaving, attachment.unblocked, seen)
        at, w = attachment.vertices, attachment.weights[..., None]
        return Occlusion((light.shadow[at] * w).sum(1), (light.bounced[at] * w).sum(1), attachment.unblocked, seen)
