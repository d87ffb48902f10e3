"""The rasteriser: run time beside error.

    python -m benchmarks.bench_rasterize                    the sphere of splats, CPU kernels against the torch reference
    python -m benchmarks.bench_rasterize --no-reference     only the kernels: seconds instead of a minute
    python -m benchmarks.bench_rasterize --cuda             also gsplat on a GPU

The scene: 20,000 round splats of scale 0.02 and opacity 0.8 on the near half of a unit sphere, 5 away, 192 x 192 pixels,
focal length 415 px, 12 feature channels; backward from random cotangents of every image but the distortion.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from benchmarks.case_store import made_with
from pipeline.engine.device import refuse_missing_cuda
from pipeline.errors import UserError
from stages.train.rasterize import Raster, rasterize
from stages.train.render_view import LAYER, SCREEN_FILTER

TARGETS = {"forward_ms": (25, 8), "forward_backward_ms": (80, 25), "times_reference": (50, 200)}  # must, aim
INPUTS = ("means", "quats", "scales", "opacities", "features")
IMAGES = ("features", "normal", "alpha", "depth_expected", "depth_median")


def sphere(count: int, channels: int, scale: float = 0.02) -> list[Tensor]:
    """Round splats tangent to the near half of the unit sphere. means, quats, scales, opacities, features"""
    g = torch.Generator().manual_seed(0)
    normal = torch.nn.functional.normalize(torch.randn(count, 3, generator=g), dim=1)
    normal[:, 2] = -normal[:, 2].abs()
    quats = torch.stack((1 + normal[:, 2], -normal[:, 1], normal[:, 0], torch.zeros(count)), 1)  # z axis to the normal
    quats[normal[:, 2] < -1 + 1e-6] = torch.tensor([0.0, 1.0, 0.0, 0.0])
    features = torch.rand(count, channels, generator=g)
    return [normal, quats, torch.full((count, 2), scale), torch.full((count,), 0.8), features]


def view(width: int, height: int, focal: float) -> tuple[Tensor, Tensor, int, int]:
    """A camera 5 away on the z axis."""
    camera = torch.eye(4)
    camera[2, 3] = 5
    return camera, torch.tensor([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]]), width, height


class Case:
    """One scene on one backend; `step` renders and, if asked, differentiates."""

    def __init__(
        self,
        splats: list[Tensor],
        camera: tuple[Tensor, Tensor, int, int],
        backend: str,
        dtype: torch.dtype,
        screen_filter: int = 1,
        layer: float = 0.0,
    ):
        self.device = "cuda" if backend == "cuda" else "cpu"
        self.inputs = [t.to(self.device, dtype, copy=True).requires_grad_() for t in splats]
        self.camera = (camera[0].to(self.device, dtype), camera[1].to(self.device, dtype), *camera[2:])
        self.backend, self.screen_filter, self.layer = backend, screen_filter, layer
        self.cotangents: list[Tensor] = []
        self.latest: Raster | None = None

    def forward(self) -> Raster:
        arguments: tuple[Any, ...] = (*self.inputs, *self.camera)
        raster = rasterize(*arguments, backend=self.backend, screen_filter=self.screen_filter, layer=self.layer)
        if self.device == "cuda":
            torch.cuda.synchronize()
        return raster

    def forward_backward(self) -> Raster:
        raster = self.forward()
        images = [getattr(raster, name) for name in IMAGES]
        if not self.cotangents:
            g = torch.Generator().manual_seed(1)
            self.cotangents = [torch.randn(i.shape, generator=g).to(i) for i in images]
        for tensor in self.inputs:
            tensor.grad = None
        torch.autograd.backward(images, self.cotangents)
        if self.device == "cuda":
            torch.cuda.synchronize()
        self.latest = raster
        return raster

    def results(self) -> dict[str, Tensor]:
        """Images and gradients of the latest step, float64 on the CPU."""
        raster = self.latest or self.forward_backward()
        found = {name: getattr(raster, name) for name in IMAGES}
        found |= {f"d {name}": t.grad for name, t in zip(INPUTS, self.inputs) if t.grad is not None}
        return {name: value.detach().cpu().double() for name, value in found.items()}


def times_ms(call: Callable[[], object], repeats: int) -> dict[str, float]:
    """Median and least wall time of a call, after two to warm up (none for a single repeat), and the median processor time
    by core, which other work on the machine disturbs least."""
    wall, busy = [], []
    for _ in range(repeats + 2 * (repeats > 1)):
        start = time.perf_counter(), time.process_time()
        call()
        wall.append((time.perf_counter() - start[0]) * 1e3)
        busy.append((time.process_time() - start[1]) * 1e3 / len(os.sched_getaffinity(0)))
    wall, busy = sorted(wall[-repeats:]), sorted(busy[-repeats:])
    return {"median": wall[repeats // 2], "least": wall[0], "processor": busy[repeats // 2]}


def compile_seconds() -> float:
    """Wall time of the first forward and backward pass with an empty kernel cache, in a process of its own."""
    code = (
        "import time, torch; from benchmarks.bench_rasterize import Case, sphere, view\n"
        "case = Case(sphere(100, 3), view(32, 32, 50.0), 'cpu', torch.float32)\n"
        "start = time.perf_counter(); case.forward_backward(); print(time.perf_counter() - start)"
    )
    with tempfile.TemporaryDirectory() as cache:
        run = subprocess.run(
            [sys.executable, "-c", code],
            env={**os.environ, "NUMBA_CACHE_DIR": cache},
            capture_output=True,
            text=True,
            check=True,
        )
    return float(run.stdout)


def differences(value: dict[str, Tensor], truth: dict[str, Tensor]) -> dict[str, float]:
    """Relative 2-norm difference by name."""
    return {name: float((value[name] - truth[name]).norm() / truth[name].norm()) for name in truth}


def main() -> None:
    """Measure, print a table, and write JSON if asked."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repeats", type=int, default=50)
    parser.add_argument("--no-reference", action="store_true", help="skip the torch reference")
    parser.add_argument("--cuda", action="store_true", help="also measure gsplat on the GPU")
    parser.add_argument("--json", type=Path, help="write the figures here")
    parser.add_argument("--captures", help="not used: the scene is made here")
    options = parser.parse_args()
    if options.cuda:
        refuse_missing_cuda()

    splats, camera = sphere(20_000, 12), view(192, 192, 415.0)
    figures: dict = {"machine": f"{platform.machine()}, {len(os.sched_getaffinity(0))} cores", "torch": torch.__version__}
    figures["load_average"] = os.getloadavg()[0]  # other work on the machine: wall times mean little above 0.5
    figures["made"] = made_with({"screen_filter": SCREEN_FILTER, "layer": LAYER})
    figures["compile_s"] = compile_seconds()
    print(f"{figures['machine']}; first call with an empty cache: {figures['compile_s']:.1f} s")
    print(f"{'':34}{'median':>9}{'least':>9}{'by core':>9}    must / aim")

    def report(label: str, times: dict[str, float], target: str | None = None) -> None:
        goal = "{} / {}".format(*TARGETS[target]) if target else ""
        print(f"{label:34}{times['median']:9.2f}{times['least']:9.2f}{times['processor']:9.2f} ms {goal}", flush=True)

    cpu = Case(splats, camera, "cpu", torch.float32)
    figures["cpu"] = {
        "forward_ms": times_ms(cpu.forward, options.repeats),
        "forward_backward_ms": times_ms(cpu.forward_backward, options.repeats),
    }
    report("cpu forward", figures["cpu"]["forward_ms"], "forward_ms")
    report("cpu forward + backward", figures["cpu"]["forward_backward_ms"], "forward_backward_ms")

    training = Case(splats, camera, "cpu", torch.float32, SCREEN_FILTER, LAYER * float(splats[2].median()))
    figures["cpu_as_in_training"] = {"forward_backward_ms": times_ms(training.forward_backward, options.repeats)}
    report("cpu both, training's filter, layers", figures["cpu_as_in_training"]["forward_backward_ms"])

    large = Case(sphere(100_000, 12, 0.01), view(612, 512, 1100.0), "cpu", torch.float32)
    figures["cpu_612x512_100k"] = {"forward_backward_ms": times_ms(large.forward_backward, max(options.repeats // 5, 1))}
    report("cpu both, 100k splats, 612 x 512", figures["cpu_612x512_100k"]["forward_backward_ms"])

    if options.cuda:
        cuda = Case(splats, camera, "cuda", torch.float32)
        figures["cuda"] = {
            "forward_ms": times_ms(cuda.forward, options.repeats),
            "forward_backward_ms": times_ms(cuda.forward_backward, options.repeats),
        }
        report("cuda forward", figures["cuda"]["forward_ms"])
        report("cuda forward + backward", figures["cuda"]["forward_backward_ms"])

    if not options.no_reference:
        slow = Case(splats, camera, "reference", torch.float32)
        figures["reference"] = {
            "forward_ms": times_ms(slow.forward, 1),
            "forward_backward_ms": times_ms(slow.forward_backward, 1),
        }
        report("reference forward", figures["reference"]["forward_ms"])
        report("reference forward + backward", figures["reference"]["forward_backward_ms"])
        for name in ("forward_ms", "forward_backward_ms"):
            ratio = figures["reference"][name]["median"] / figures["cpu"][name]["median"]
            figures[f"times_reference_{name[:-3]}"] = ratio
            print(f"{'reference / cpu, ' + name[:-3]:34}{ratio:9.0f} x            {TARGETS['times_reference']}")
        figures["relative_difference"] = differences(cpu.results(), slow.results())
        print("relative difference: " + ", ".join(f"{k} {v:.0e}" for k, v in figures["relative_difference"].items()))
    if options.json:
        options.json.parent.mkdir(parents=True, exist_ok=True)
        options.json.write_text(json.dumps(figures, indent=2) + "\n")


if __name__ == "__main__":
    try:
        main()
    except UserError as fault:
        raise SystemExit(f"bench_rasterize: {fault}") from None
