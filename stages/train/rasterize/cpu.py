"""The rasteriser on the CPU: numba kernels over tiles, float32, the same function as `reference`.

The results do not depend on the number of threads, bit for bit: every pixel is blended by one thread, and every
(tile, splat) pair writes its gradients to a slot of its own, summed in splat order afterwards.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from torch import Tensor

from pipeline.kernels.simd import LANES, TILE
from pipeline.kernels.threads import row_buffers, run_on_all_cores

from . import constants as k
from .kernel_backward import backward_size, slot_width, tiles_backward
from .kernel_bin import bin_splats, depth_order
from .kernel_block import BLOCKS, CHANNELS, GROUP, LAYERS, RECORD_ROWS
from .kernel_forward import blend_tiles, forward_size, largest_weights
from .kernel_project import GEO, project, project_backward
from .raster import Raster


def rasterize_cpu(
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
    """`rasterize` on the CPU, computed in float32."""
    view = _View(world_to_camera, intrinsics, width, height, near, pixel_mask, screen_filter, layer, len(means))
    inputs = [t.to(torch.float32) for t in (means, quats, scales, opacities, features)]
    blended, normal, alpha, expected, median, distortion = _Rasterize.apply(view, *inputs)
    side = [torch.from_numpy(a) for a in (view.screen_gradient, view.visible, view.radii)]
    return Raster(blended, alpha, normal, expected, median, distortion, *side)


class _View:
    """One call's camera, and the facts of it that are not differentiated."""

    def __init__(
        self,
        world_to_camera: Tensor,
        intrinsics: Tensor,
        width: int,
        height: int,
        near: float | None,
        pixel_mask: Tensor | None,
        screen_filter: int,
        layer: float,
        count: int,
    ) -> None:
        lens = intrinsics.detach()
        self.lens = np.array([lens[0, 0], lens[1, 1], lens[0, 2], lens[1, 2]], np.float32)
        self.camera = np.ascontiguousarray(world_to_camera.detach().numpy(), np.float32)
        self.width, self.height, self.near = width, height, near
        self.screen = np.float32(k.SCREEN_INVERSE_VARIANCE * screen_filter**2 if screen_filter else np.inf)
        self.layer = np.float32(layer)
        self.mask = np.ones((height, width), bool) if pixel_mask is None else np.ascontiguousarray(pixel_mask.numpy())
        self.screen_gradient, self.visible, self.radii = (np.zeros(count, np.float32) for _ in range(3))

    def wanted_tiles(self) -> np.ndarray:
        """Tiles with a pixel in the mask. [rows, columns] bool"""
        rows, columns = -(-self.height // TILE), -(-self.width // TILE)
        padded = np.zeros((rows * TILE, columns * TILE), bool)
        padded[: self.height, : self.width] = self.mask
        return np.asarray(padded.reshape(rows, TILE, columns, TILE).any((1, 3)))

    def near_plane(self, means: np.ndarray) -> np.float32:
        """`near`, or `NEAR_FRACTION` of the (lower) median camera z of the splats in front of the camera."""
        if self.near is not None:
            return np.float32(self.near)
        z = means @ self.camera[2, :3] + self.camera[2, 3]
        z = z[z > 0]
        return np.float32(k.NEAR_FRACTION * np.partition(z, (len(z) - 1) // 2)[(len(z) - 1) // 2] if len(z) else 1.0)


def _array(tensor: Tensor) -> np.ndarray:
    return tensor.detach().contiguous().numpy()


class _Rasterize(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, view: _View, *inputs: Tensor) -> tuple[Tensor, ...]:
        arrays = [_array(t) for t in inputs]
        count, channels = arrays[-1].shape
        size = (view.height, view.width)
        geo = np.empty((count, GEO), np.float32)
        attributes = np.empty((count, -(-(channels + 3) // GROUP) * GROUP), np.float32)
        box = np.empty((count, 4), np.int32)
        run_on_all_cores(
            project, *arrays, view.camera, view.lens, view.near_plane(arrays[0]), view.screen, view.width, view.height,
            geo, attributes, box, view.radii,
        )  # fmt: skip
        pairs = bin_splats(box, depth_order(geo), view.wanted_tiles())
        tile_start, pair_splat, pair_slot, slot_start = pairs
        blended, normal, scalars = (np.empty(shape, np.float32) for shape in ((*size, channels), (*size, 3), (4, *size)))
        pair_weight = np.empty(len(pair_slot), np.float32)
        tile_used = np.empty(len(tile_start) - 1, np.int64)
        tile_state = np.empty((len(tile_used), BLOCKS * BLOCKS, CHANNELS), np.float32)
        record = LAYERS * (RECORD_ROWS + attributes.shape[1]) * LANES if view.layer > 0 else 0
        records = np.empty((len(tile_used), BLOCKS * BLOCKS * record), np.float32)  # filled where layers end
        run_on_all_cores(
            blend_tiles, tile_start, pair_splat, pair_slot, geo, attributes, view.mask, view.screen, view.layer,
            blended, normal, scalars, pair_weight, tile_used, tile_state, records,
            row_buffers(forward_size(attributes.shape[1])),
        )  # fmt: skip
        largest_weights(slot_start, pair_weight, view.visible)
        ctx.view, ctx.pairs, ctx.tiles, ctx.splats = view, pairs, (tile_used, tile_state, records), (geo, attributes)
        ctx.images = blended, normal
        ctx.save_for_backward(*inputs)
        ctx.set_materialize_grads(False)
        return tuple(torch.from_numpy(a) for a in (blended, normal, *scalars))

    @staticmethod
    def backward(ctx: Any, *cotangents: Tensor | None) -> tuple[Tensor | None, ...]:
        view: _View = ctx.view
        arrays = [_array(t) for t in ctx.saved_tensors]
        means, quats, scales = arrays[:3]
        tile_start, pair_splat, pair_slot, slot_start = ctx.pairs
        tile_used, tile_state, records = ctx.tiles
        geo, attributes = ctx.splats
        size = (view.height, view.width)
        d_features, d_normal, *_ = (
            np.zeros((*size, depth), np.float32) if cotangent is None else _array(cotangent)
            for depth, cotangent in zip((arrays[-1].shape[1], 3), cotangents)
        )
        d_scalars = np.zeros((4, *size), np.float32)
        for plane, cotangent in zip(d_scalars, cotangents[2:], strict=True):
            if cotangent is not None:
                plane[...] = cotangent.numpy()
        used = attributes.shape[1] if cotangents[1] is not None else -(-d_features.shape[2] // GROUP) * GROUP
        slots = np.empty((len(pair_slot), slot_width(attributes.shape[1])), np.float32)
        run_on_all_cores(
            tiles_backward, tile_start, tile_used, tile_state, records, pair_splat, pair_slot, geo, attributes, view.screen,
            view.layer, bool(d_scalars[3].any()), used, *ctx.images, d_features, d_normal, d_scalars, slots,
            row_buffers(backward_size(attributes.shape[1])),
        )  # fmt: skip
        gradients = [np.zeros_like(a) for a in arrays]
        view.screen_gradient[:] = 0
        run_on_all_cores(
            project_backward, means, quats, scales, view.camera, view.lens, geo, slot_start, slots,
            *gradients, view.screen_gradient, row_buffers(slots.shape[1]),
        )  # fmt: skip
        return None, *(torch.from_numpy(g) for g in gradients)
