"""Trains a few steps on a device: `python train_on_standin.py SOURCES.pkl cpu|standin STEPS` prints losses and waits as JSON.

On the stand-in, gsplat and the sparse product of the prefilter, which are other people's code, are the CPU's.
"""

from __future__ import annotations

import json
import pickle
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import standin_device
import torch

from pipeline.shading.symmetry import SymmetricMap
from stages.train import renderer, upkeep
from stages.train import trainer as training
from stages.train.parameters import TrainParameters
from stages.train.rasterize import Raster, cuda
from stages.train.rasterize.cpu import rasterize_cpu
from stages.train.setup import prepare_training

IMAGES = ("features", "alpha", "normal", "depth_expected", "depth_median", "distortion", "visible", "radii")


class Island(torch.autograd.Function):
    """A function of the CPU's tensors, given the device's."""

    @staticmethod
    def forward(ctx: Any, call: Callable[..., tuple[torch.Tensor, ...]], *given: torch.Tensor) -> Any:
        with torch.enable_grad():
            ctx.given = [t.detach().cpu().requires_grad_() for t in given]
            ctx.made = call(*ctx.given)
        return tuple(t.detach().to(standin_device.NAME) for t in ctx.made)

    @staticmethod
    def backward(ctx: Any, *slopes: torch.Tensor) -> Any:
        pairs = [(made, slope.cpu()) for made, slope in zip(ctx.made, slopes) if made.requires_grad]
        found = torch.autograd.grad([m for m, _ in pairs], ctx.given, [s for _, s in pairs], materialize_grads=True)
        return None, *(t.to(standin_device.NAME) for t in found)


def rasterize_there(*given: Any, **options: Any) -> Raster:
    """The CPU's rasteriser in the place of gsplat."""
    kept: list[Raster] = []

    def call(*splats: torch.Tensor) -> tuple[torch.Tensor, ...]:
        view = (t.cpu() if isinstance(t, torch.Tensor) else t for t in given[5:])
        kept.append(rasterize_cpu(*splats, *view, **options))
        return tuple(getattr(kept[0], name) for name in IMAGES)

    images = dict(zip(IMAGES, Island.apply(call, *given[:5])))
    pull = kept[0].screen_gradient.to(standin_device.NAME)

    def keep(_: torch.Tensor) -> None:
        pull.copy_(kept[0].screen_gradient)

    if given[0].requires_grad:
        given[0].register_hook(keep)
    return replace(kept[0], screen_gradient=pull, **images)


def main() -> None:
    """Train and tell."""
    sources, device, steps = pickle.loads(Path(sys.argv[1]).read_bytes()), sys.argv[2], int(sys.argv[3])
    torch.set_num_threads(1)
    if device == standin_device.NAME:
        torch.autograd.set_multithreading_enabled(False)  # a Python device's errors end the process in another thread
        cuda.rasterize_cuda = rasterize_there  # type: ignore[assignment]
        SymmetricMap.plain = lambda self, x: Island.apply(lambda t: (self(t),), x)[0]  # type: ignore[method-assign]
    upkeep.REFRESH = training.REFRESH = 2
    upkeep.CYCLE = upkeep.OCCLUSION_FROM = 4
    renderer.LEAST_BLOCKED = -1.0  # trace, though next to nothing is occluded
    p = TrainParameters(iterations=steps, max_splats=400, splat_pixels=3.0, hull_resolution=32, environment_resolution=8)
    start = prepare_training(sources, "stokes", {}, "y", p, device)
    trainer = training.Trainer(start.scene, start.pyramids, "stokes", start.frame, p, "cuda" if device != "cpu" else "cpu")
    losses, waits = [], {}
    for _ in range(steps):
        standin_device.waits.clear()
        losses.append(trainer.step())
        waits = {place: count for place, count in standin_device.waits.items() if __file__ not in place}
    print(json.dumps({"losses": losses, "waits": waits, "traced": trainer.scene.splat_occlusion is not None}))


if __name__ == "__main__":
    main()
