"""Light: error against run time of every choice of indirect and of mirrored light, against path-traced truth.

    python -m benchmarks.bench_light --captures DIR [--out DIR] [--only NAME ...] [--no-training]

DIR holds captures with `gt/` and `gt/relight/` (or the environment variable POLARFIELD_CAPTURES); a bowl of albedo 0.9 is
rendered beside them (`python -m synth --only bowl`). Shading gets the true shape, IoR, roughness and maps, and the true albedo,
or, where none is known, the one that makes the captured s0 right: what is left is the error of the light. Two sets of choices:
all kinds of indirect light with the finest affordable mirror, and all mirrors with traced light; "traced, sharp" is what
`relight` does. Seconds are of one core's
processor time. `training` is what each kind adds to a step and to the rendering of a test view, as PhyGaP prints it (24.1 and
26.8 %). Writes light.json after every case, and light.png; cases that are there already are kept, if made with these settings.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("NUMBA_NUM_THREADS", "1")

import numpy as np
import torch

from benchmarks.light_training import timed, training_overhead
from benchmarks.light_truth import CAPTURED, Pixels, Truth, errors, load
from pipeline.optics.model_names import ANCHOR_PLACES, ANCHOR_WEIGHTS
from pipeline.shading import LightField, Occlusion, Prefilter, latlong, shade
from pipeline.shading.gridmap import GridMap
from pipeline.shading.sharp_shadows import Points, SharpShadows
from pipeline.shading.transfer import Attachment, Transfer

CAPTURES = ("teapot-lebombo", "spot-venice", "igea-forest", "bowl")
SETTINGS = {"cube": 128, "transfer": 16, "lobe": "beckmann", "mirror": "tree"}
MIRRORS = ("split", "lobe-12", "tree-coarse", "tree", "tree-fine")
BOWL = {"views": 8, "spp": 400}
TRAINED = ("teapot-lebombo",)  # captures on which training is timed
PLOTTED = (("s0, captured", "s0_mean_pct", False), ("s0, relit", "s0_mean_pct", True), ("body, relit", "diffuse_pct", True))
Occluder = Callable[[Pixels], Occlusion | None]


class Nothing:
    """No indirect light."""

    def __init__(self, truth: Truth) -> None:
        self.truth = truth

    def tie(self, pixels: Pixels) -> None:
        """What a view costs once, whatever the map."""

    def under(self, cube: torch.Tensor, light: LightField) -> Occluder:
        """What pixels receive under a map."""
        return lambda pixels: None


class Traced(Nothing):
    """Ours without the edges of lamps' shadows: rays of the mesh's vertices, or of the pixels."""

    def __init__(self, truth: Truth, own_rays: bool = False) -> None:
        super().__init__(truth)
        ior = float(np.median(np.concatenate([v.ior for v in truth.views])))
        self.transfer = Transfer(truth.occluder, truth.albedo, ior=ior, resolution=int(SETTINGS["transfer"]))
        self.own_rays = own_rays
        self.tied: dict[int, Attachment] = {}

    def tie(self, pixels: Pixels) -> None:
        """Cast the rays of a view's pixels."""
        p = pixels
        self.tied[id(p)] = self.transfer.attach(
            p.points, p.normal, p.view, p.roughness, lobe="beckmann", own_rays=self.own_rays
        )  # fmt: skip

    def under(self, cube: torch.Tensor, light: LightField) -> Occluder:
        """What pixels receive under a map."""
        surface = self.transfer.light(cube)
        return lambda pixels: self.transfer.occlusion(self.tied[id(pixels)], surface)


class Sharp(Traced):
    """Ours, as relighting has it: the bright parts of a map point by point."""

    def under(self, cube: torch.Tensor, light: LightField) -> Occluder:
        """What pixels receive under a map."""
        surface = self.transfer.light(cube)
        shadows = SharpShadows(self.transfer, surface, light)
        return lambda p: shadows.occlusion(
            Points.of(p.points, p.normal, p.view, p.roughness, p.ior), self.tied[id(p)], surface
        )  # fmt: skip


class Anchored(Nothing):
    """PhyGaP's GridMap."""

    def __init__(self, truth: Truth, weights: str, anchors: str) -> None:
        super().__init__(truth)
        self.grid = GridMap(truth.occluder, truth.albedo, weights=weights, anchors=anchors, lobe="beckmann")

    def under(self, cube: torch.Tensor, light: LightField) -> Occluder:
        """What pixels receive under a map."""
        local = self.grid.light(cube, light)
        return lambda p: self.grid.occlusion(p.points, p.normal, p.view, p.roughness, local)


class Learnt(Traced):
    """Ref-Gaussian's harmonics as well as they could be learnt: what is mirrored in the capture, under whatever light."""

    def under(self, cube: torch.Tensor, light: LightField) -> Occluder:
        """What pixels receive under a map: that of the capture alone, for the first one asked for."""
        if not hasattr(self, "captured"):
            self.captured = super().under(cube, light)

        def at(p: Pixels) -> Occlusion:
            o = self.captured(p)
            assert o is not None
            return Occlusion(torch.ones_like(o.seen), torch.zeros_like(o.seen), o.unblocked, o.seen)

        return at


def choices() -> dict[str, tuple[Callable[[Truth], Nothing], str]]:
    """Every choice by name: how its indirect light is made, and its mirror."""
    mirror = str(SETTINGS["mirror"])
    out: dict[str, tuple[Callable[[Truth], Nothing], str]] = {
        "none": (Nothing, mirror),
        "traced": (Traced, mirror),
        "traced, sharp": (Sharp, mirror),
        "sh, ideally learnt": (Learnt, mirror),
    }
    for place in ANCHOR_PLACES:
        for weights in ANCHOR_WEIGHTS if place == "box" else ANCHOR_WEIGHTS[:1]:
            out[f"gridmap, {place}, {weights}"] = (lambda t, w=weights, p=place: Anchored(t, w, p)), mirror
    out |= {f"traced, mirror {m}": (Traced, m) for m in MIRRORS if m != mirror}
    return out | {"traced, rays of every pixel": (lambda t: Traced(t, True), mirror)}


def tensor(a: Any) -> torch.Tensor:
    """float32, whole."""
    return torch.as_tensor(np.ascontiguousarray(a), dtype=torch.float32)


def shaded(p: Pixels, albedo: torch.Tensor, light: LightField, occlusion: Occlusion | None, mirror: str) -> Any:
    """A view's pixels, shaded."""
    surface = (tensor(p.normal), tensor(p.view), albedo, tensor(p.roughness), tensor(p.ior), tensor(p.x), tensor(p.y))
    return shade(*surface, light, occlusion=occlusion, mirror=mirror)


def measure(truth: Truth, make: Callable[[Truth], Nothing], mirror: str, lights: dict[str, tuple]) -> dict[str, Any]:
    """One choice under every light: errors, and seconds for the mesh, for a map, and for a view under one map."""
    kind, mesh_s = timed(lambda: make(truth))
    solved: list[torch.Tensor] = []
    out: dict[str, Any] = {"mesh_s": mesh_s, "lights": {}}
    tie_s = [timed(lambda p=p: kind.tie(p))[1] for p in truth.views]
    map_s, view_s = [], []
    for name, (cube, light) in lights.items():
        occluder, seconds = timed(lambda c=cube, f=light: kind.under(c, f))
        map_s.append(seconds)
        images, bodies = [], []
        for k, p in enumerate(truth.views):
            if name == CAPTURED:
                albedo = None if p.albedo is None else tensor(p.albedo)
                if albedo is None:  # s0 = albedo x body + mirror
                    unit = shaded(p, torch.ones(len(p.normal), 3), light, occluder(p), mirror)
                    left = tensor(p.truth[name])[:, 0] - unit.specular
                    albedo = (left / unit.diffuse.clamp_min(1e-6)).clamp(0, 1)
                solved.append(albedo)
            result, seconds = timed(lambda p=p, k=k, f=light, o=occluder: shaded(p, solved[k], f, o(p), mirror))
            view_s.append(seconds)
            images.append(result.stokes.numpy())
            bodies.append(result.diffuse.numpy())
        out["lights"][name] = errors(truth.views, images, bodies, name)
    return out | {"map_s": float(np.median(map_s)), "ms_per_view": 1e3 * float(np.median(tie_s) + np.median(view_s))}


def plot(results: dict[str, Any], path: Path) -> None:
    """One row a capture: mean s0 error as captured and relit, and of the diffuse part, over milliseconds a view."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    shown = {name: c for name, c in results.items() if c.get("choices")}
    figure, axes = pyplot.subplots(len(shown), 3, figsize=(15, 3.6 * len(shown)), squeeze=False)
    for row, (capture, found) in zip(axes, shown.items()):
        for axis, (title, figure_name, relit) in zip(row, PLOTTED):
            for k, (name, case) in enumerate(found["choices"].items()):
                values = [e[figure_name] for light, e in case["lights"].items() if (light != CAPTURED) == relit]
                axis.plot(case["ms_per_view"], np.mean(values), "os^vD"[k // 10 + (k % 5)], color=f"C{k % 10}", label=name)
            axis.set(title=f"{capture}: {title} (%)", xlabel="ms a view", xscale="log", ylim=(0, None))
    axes[0][-1].legend(fontsize=6, loc="upper left", bbox_to_anchor=(1, 1))
    figure.tight_layout()
    figure.savefig(path, dpi=90)
    pyplot.close(figure)


def run(name: str, folder: Path, out: Path, results: dict[str, Any], training: bool) -> None:
    """Everything of one capture that is not there yet, saved case by case."""

    def save() -> None:
        (out / "light.json").write_text(json.dumps(results, indent=1) + "\n")

    found = results["captures"].setdefault(name, {"choices": {}})
    missing = {n: c for n, c in choices().items() if n not in found["choices"]}
    if missing:
        truth = load(folder)
        lights = {}
        for light, radiance in truth.maps.items():
            cube = tensor(latlong.to_cube(radiance, int(SETTINGS["cube"])))
            lights[light] = cube, Prefilter(int(SETTINGS["cube"]), str(SETTINGS["lobe"])).apply(cube)
        warm = truth.views[0]
        for mirror in MIRRORS:  # compiled before anything is timed
            shaded(warm, torch.ones(len(warm.normal), 3), lights[CAPTURED][1], None, mirror)
        for choice, (make, mirror) in missing.items():
            found["choices"][choice] = case = measure(truth, make, mirror, lights)
            print(f"{name}: {choice}: {case['ms_per_view']:.0f} ms", flush=True)
            for light, e in case["lights"].items():
                print("   ", light, {k: round(v, 3) for k, v in e.items()}, flush=True)
            save()
    if training and name in TRAINED and "training" not in found:
        found["training"] = training_overhead(folder, out / "light-inputs")
        save()


def main() -> None:
    """Run what is not there yet, writing after each case."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--captures", type=Path, default=os.environ.get("POLARFIELD_CAPTURES"))
    parser.add_argument("--out", type=Path, default=Path("build/bench"))
    parser.add_argument("--only", nargs="*", default=[], help="capture names")
    parser.add_argument("--no-training", action="store_true", help="leave out what each kind adds to training and rendering")
    arguments = parser.parse_args()
    out = arguments.out
    out.mkdir(parents=True, exist_ok=True)
    torch.set_num_threads(1)
    machine = {"cpu": platform.processor() or platform.machine(), "cores": os.cpu_count()}
    results: dict[str, Any] = {"machine": machine, "settings": SETTINGS, "captures": {}}
    if (out / "light.json").exists():
        earlier = json.loads((out / "light.json").read_text())
        results["captures"] = earlier["captures"] if earlier["settings"] == SETTINGS else {}
    for name in arguments.only or CAPTURES:
        folder = (arguments.captures or Path()) / name
        if name == "bowl" and not folder.is_dir():
            folder = out / "light-inputs" / "bowl"
            command = [sys.executable, "-m", "synth", str(folder.parent), "--only", "bowl"]
            subprocess.run([*command, *(str(x) for k, v in BOWL.items() for x in (f"--{k}", v))], check=True)
        if folder.is_dir():
            run(name, folder, out, results, not arguments.no_training)
    plot(results["captures"], out / "light.png")


if __name__ == "__main__":
    main()
