"""The definition: 2D Gaussian rasterisation in plain torch, gradients by autograd. Slow; run it in float64.

With p the centre, t_u, t_v, n the axes of a splat in camera coordinates, P = p / p_z, and (dx, dy) a pixel relative to the
projected centre, the perspective-correct intersection (2DGS Eqs. 8-10) is, divided through by its value at the centre,

    q = 1 + (n_x dx / fx + n_y dy / fy) / (n . P)                 = z_centre / z_hit
    u = (p_z / s_u) ((t_v x P)_x dx / fx + (t_v x P)_y dy / fy) / (n . P) / q
    v = (p_z / s_v) ((P x t_u)_x dx / fx + (P x t_u)_y dy / fy) / (n . P) / q

Nothing cancels near the centre, and only p_z / s and p_z itself carry units.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, fields

import torch
from torch import Tensor
from torch.utils.checkpoint import checkpoint

from . import constants as k
from .layers import layer_numbers, layer_weights
from .raster import Raster

BLOCK = 16  # pixels a side evaluated at once; bounds memory only


@dataclass
class Projection:
    """Visible splats of one view, sorted by the camera z of their centres. M <= N."""

    index: Tensor  # [M] into the N inputs
    centre: Tensor  # [M, 2] projected centre, px
    homography: Tensor  # [M, 3, 2] rows u, v, q: derivatives by (dx, dy), 1/px
    depth: Tensor  # [M] camera z of the centre
    normal: Tensor  # [M, 3] world, facing the camera
    flat: Tensor  # [M] bool: too edge-on for the object-space kernel
    low: Tensor  # [M, 2] bounding box of the cut-off, px
    high: Tensor  # [M, 2]

    def take(self, chosen: Tensor) -> Projection:
        """The same record for a subset of its splats."""
        return Projection(**{f.name: getattr(self, f.name)[chosen] for f in fields(self)})


def rotation_matrix(quats: Tensor) -> Tensor:
    """Rotations of normalised wxyz quaternions. [N, 4] -> [N, 3, 3]"""
    w, x, y, z = torch.nn.functional.normalize(quats, dim=-1, eps=0.0).unbind(-1)
    rows = (
        (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )
    return torch.stack([torch.stack(row, -1) for row in rows], -2)


def default_near(depth: Tensor) -> float:
    """`NEAR_FRACTION` of the (lower) median camera z of the splats in front of the camera. [N] -> distance"""
    front = depth[depth > 0]
    return k.NEAR_FRACTION * float(front.median()) if len(front) else 1.0


def project(
    means: Tensor,
    quats: Tensor,
    scales: Tensor,
    opacities: Tensor,
    world_to_camera: Tensor,
    intrinsics: Tensor,
    near: float | None,
    screen_filter: int,
) -> Projection:
    """Centres, ray-to-splat homographies, normals and bounding boxes of the splats that can contribute, in depth order."""
    rotation, focal = world_to_camera[:3, :3], torch.stack((intrinsics[0, 0], intrinsics[1, 1]))
    point = means @ rotation.T + world_to_camera[:3, 3]  # [N, 3]
    near = default_near(point[:, 2].detach()) if near is None else near
    finite = torch.cat((means, quats, scales, opacities[:, None]), 1).isfinite().all(1) & (quats != 0).any(1)
    order = torch.argsort(point[:, 2].detach(), stable=True)
    index = order[(finite & (point[:, 2] >= near) & (opacities >= k.ALPHA_MIN) & (scales > 0).all(1))[order]]

    world_axes = rotation_matrix(quats[index])  # [M, 3, 3], columns t_u, t_v, n
    tu, tv, n = (rotation @ world_axes).unbind(-1)  # [M, 3] each
    z = point[index, 2]
    P = point[index] / z[:, None]  # [M, 3]
    facing = (n * P).sum(-1)
    flat = facing.abs() < k.MIN_COSINE * P.norm(dim=-1)
    safe = torch.where(flat, torch.ones_like(facing), facing)[:, None]
    sigma = torch.maximum(scales[index], k.MIN_SIGMA_PX * (z / focal.max())[:, None])  # [M, 2]
    homography = torch.stack(
        (
            torch.linalg.cross(tv, P)[:, :2] * (z / sigma[:, 0])[:, None] / safe / focal,
            torch.linalg.cross(P, tu)[:, :2] * (z / sigma[:, 1])[:, None] / safe / focal,
            n[:, :2] / safe / focal,
        ),
        1,
    )  # [M, 3, 2]
    centre = P[:, :2] * focal + intrinsics[:2, 2]
    low, high = bounds(P, z, tu * sigma[:, :1], tv * sigma[:, 1:], focal, opacities[index], flat, screen_filter)
    normal = world_axes[:, :, 2] * torch.where(facing > 0, -1.0, 1.0).to(z.dtype)[:, None]
    return Projection(index, centre, homography, z, normal, flat, centre + low, centre + high)


def bounds(
    P: Tensor, z: Tensor, u: Tensor, v: Tensor, focal: Tensor, opacity: Tensor, flat: Tensor, screen_filter: int
) -> tuple[Tensor, Tensor]:
    """Box of the pixels where alpha can reach the threshold, relative to the centre. [M, 2] each, px

    A tangent m of the outline p + r (u cos + v sin), u = s_u t_u and v = s_v t_v, solves
    (r^2 |d|^2 - z^2) m^2 - 2 r^2 (e . d) m + r^2 |e|^2 = 0 with d = (u_z, v_z), e = (u, v)_xy - P_xy d.
    """
    with torch.no_grad():
        r2 = (2 * torch.log(opacity.clamp(max=1.0) / k.ALPHA_MIN)).clamp(max=k.CUTOFF_RHO)[:, None]  # [M, 1]
        d = torch.stack((u[:, 2], v[:, 2]), 1)[:, None]  # [M, 1, 2]
        e = torch.stack((u[:, :2], v[:, :2]), 2) - P[:, :2, None] * d  # [M, 2 (x, y), 2 (u, v)]
        dd, ed, ee = (d * d).sum(-1) * r2, (e * d).sum(-1) * r2, (e * e).sum(-1) * r2
        leading = dd - (z * z)[:, None]  # negative while the disc is in front of the camera
        spread = (ed * ed - leading * ee).clamp(min=0).sqrt()
        low, high = (ed + spread) / leading * focal, (ed - spread) / leading * focal
        open_ended = (dd.sqrt() > k.MAX_HALF_ANGLE_FRACTION * z[:, None]).expand_as(low)
        low = torch.where(open_ended, -math.inf, low)
        high = torch.where(open_ended, math.inf, high)
        low, high = low.masked_fill(flat[:, None], 0.0), high.masked_fill(flat[:, None], 0.0)
        if screen_filter:
            radius = (r2 / k.SCREEN_INVERSE_VARIANCE).sqrt() / screen_filter
            low, high = torch.minimum(low, -radius), torch.maximum(high, radius)
        return low - k.BOUNDS_MARGIN_PX, high + k.BOUNDS_MARGIN_PX


def splat_alpha(
    pixels: Tensor, splats: Projection, centre: Tensor, opacity: Tensor, near: float, screen_filter: int
) -> tuple[Tensor, Tensor]:
    """Opacity and camera z of every splat at every pixel. pixels [P, 2], centre [P, n, 2] -> [P, n] each"""
    delta = pixels[:, None] - centre  # [P, n, 2]
    u, v, q = (torch.einsum("pnd,nkd->knp", delta, splats.homography)).transpose(1, 2)
    q = 1 + q
    in_front = (q > k.MIN_RELATIVE_DEPTH_INVERSE) & (q * near <= splats.depth) & ~splats.flat
    q = torch.where(in_front, q, torch.ones_like(q))
    rho = torch.where(in_front, (u * u + v * v) / (q * q), torch.full_like(q, math.inf))
    z = splats.depth / q
    if screen_filter:
        screen = k.SCREEN_INVERSE_VARIANCE * screen_filter**2 * (delta * delta).sum(-1)
        z = torch.where(screen < rho, splats.depth.expand_as(z), z)
        rho = torch.minimum(rho, screen)
    inside = rho <= k.CUTOFF_RHO
    alpha = (opacity * torch.exp(-0.5 * torch.where(inside, rho, torch.zeros_like(rho)))).clamp(max=k.ALPHA_MAX)
    return torch.where(inside & (alpha >= k.ALPHA_MIN), alpha, torch.zeros_like(alpha)), z


def blend(alpha: Tensor, z: Tensor, attributes: Tensor, layer: float = 0.0) -> tuple[Tensor, Tensor]:
    """Front-to-back blending. alpha, z [P, n], attributes [n, A] -> image [P, A + 4], largest possible weights [P, n].

    The last four channels are alpha, expected depth, median depth, distortion; they are blended front to back with `layer` too.
    """
    if layer > 0:
        pixel, rank = (alpha > 0).nonzero(as_tuple=True)
        with torch.no_grad():
            number, goes_on = layer_numbers(alpha[pixel, rank], z[pixel, rank], pixel, layer)
        alpha = alpha.index_put((pixel, rank), alpha[pixel, rank] * goes_on)
    after = torch.cumprod(1 - alpha, dim=1)
    before = torch.cat((torch.ones_like(after[:, :1]), after[:, :-1]), 1)
    counted = torch.ones_like(after, dtype=torch.bool) if layer > 0 else after >= k.TRANSMITTANCE_STOP
    weight = alpha * before * counted
    halves = counted & (before > 0.5) & (after <= 0.5)
    moment = [(weight * (z - z.detach()[:, :1]) ** j).sum(1) for j in range(3)]  # shifted: the variance does not change
    outputs = (moment[0], (weight * z).sum(1), (z * halves).sum(1), moment[0] * moment[2] - moment[1] ** 2)
    most = weight
    if layer > 0:
        nothing = torch.zeros_like(weight)
        weight, most = (nothing.index_put((pixel, rank), w) for w in layer_weights(alpha[pixel, rank], number, pixel))
    return torch.cat((weight @ attributes, torch.stack(outputs, 1)), 1), most.detach()


def blocks(width: int, height: int) -> Iterator[tuple[slice, slice]]:
    """Rows and columns of the image in blocks of BLOCK x BLOCK pixels."""
    for y in range(0, height, BLOCK):
        for x in range(0, width, BLOCK):
            yield slice(y, min(y + BLOCK, height)), slice(x, min(x + BLOCK, width))


def rasterize_reference(
    means: Tensor,  # [N, 3]
    quats: Tensor,  # [N, 4]
    scales: Tensor,  # [N, 2]
    opacities: Tensor,  # [N]
    features: Tensor,  # [N, C]
    world_to_camera: Tensor,  # [4, 4]
    intrinsics: Tensor,  # [3, 3]
    width: int,
    height: int,
    *,
    near: float | None = None,
    pixel_mask: Tensor | None = None,  # [H, W]
    screen_filter: int = 1,
    layer: float = 0.0,
) -> Raster:
    """`rasterize` by its definition, in the dtype of `means`."""
    count, channels, dtype = len(means), features.shape[1], means.dtype
    world_to_camera, intrinsics = world_to_camera.to(dtype), intrinsics.to(dtype)
    splats = project(means, quats, scales, opacities, world_to_camera, intrinsics, near, screen_filter)
    if near is None:
        near = default_near((means.detach() @ world_to_camera[2, :3]) + world_to_camera[2, 3])
    screen_gradient, visible, radii = (torch.zeros(count, dtype=dtype) for _ in range(3))
    absolute = torch.zeros(count, 2, dtype=dtype)  # sum over pixels of |dL/d centre|
    size = torch.tensor((width, height), dtype=dtype)
    on_screen = ((splats.high > 0) & (splats.low < size)).all(1)
    half = (0.5 * (splats.high - splats.low).amax(1)).clamp(max=max(width, height))
    radii[splats.index] = torch.where(on_screen, half, torch.zeros_like(half)).detach()

    def block_image(pixels: Tensor, chosen: Tensor) -> Tensor:
        near_by = splats.take(chosen)
        centre = near_by.centre.expand(len(pixels), -1, -1)
        if centre.requires_grad:

            def add_absolute(gradient: Tensor | None) -> None:
                if gradient is not None:
                    absolute.index_add_(0, near_by.index, gradient.abs().sum(0))
                    screen_gradient.copy_(absolute.norm(dim=1))

            centre.register_hook(add_absolute)
        alpha, z = splat_alpha(pixels, near_by, centre, opacities[near_by.index], near, screen_filter)
        image, weight = blend(alpha, z, torch.cat((features[near_by.index], near_by.normal), 1), layer)
        visible[near_by.index] = torch.maximum(visible[near_by.index], weight.amax(0))
        return image

    places, values = [], []
    for rows, columns in blocks(width, height):
        y, x = torch.meshgrid(torch.arange(rows.start, rows.stop), torch.arange(columns.start, columns.stop), indexing="ij")
        wanted = torch.ones_like(x, dtype=torch.bool) if pixel_mask is None else pixel_mask[rows, columns]
        pixels = torch.stack((x[wanted], y[wanted]), -1).to(dtype) + 0.5
        if not len(pixels):
            continue
        overlaps = (splats.high >= pixels.amin(0)) & (splats.low <= pixels.amax(0))
        chosen = overlaps.all(1).nonzero()[:, 0]
        if len(chosen):
            places.append(torch.stack((y[wanted], x[wanted])))
            values.append(checkpoint(block_image, pixels, chosen, use_reentrant=False))
    image = torch.zeros(height, width, channels + 7, dtype=dtype)
    if values:
        image = image.index_put(tuple(torch.cat(places, 1)), torch.cat(values))
    parts = torch.split(image, [channels, 3, 1, 1, 1, 1], dim=2)
    blended, normal, alpha, expected, median, distortion = parts
    scalars = (alpha[..., 0], normal, expected[..., 0], median[..., 0], distortion[..., 0])
    return Raster(blended, *scalars, screen_gradient=screen_gradient, visible=visible, radii=radii)
