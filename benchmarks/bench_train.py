"""Training: error against run time for full Stokes, two unknown polarisers and RGB only, and what each piece buys.

    python -m benchmarks.bench_train --captures DIR [--out DIR] [--iterations N] [--quick] [--resume] [--only NAME ...]
        [--device cuda]

DIR holds captures with `gt/` (or the environment variable POLARFIELD_CAPTURES). Each capture with full Stokes images is
trained as it is, as if photographed behind two polarisers of unknown angle (23 and 110 degrees, alternating views), and
as plain colour; then, for fewer steps, with one piece of the method changed at a time. Captures in which concavities were
found are trained once more without the search for them, for all steps: fewer end before the first. Writes train.json and
train.png. With --resume, runs in OUT/train.json that were made with other parameters than today's are made anew.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import resource
import time
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")

import numpy as np

from pipeline.engine.device import refuse_missing_cuda
from pipeline.errors import UserError

ANGLES_DEG = {"lp0": 23.0, "lp1": 110.0}
MODES = ("stokes", "polarisers", "none")
PIECES_STEPS = 600  # steps of the runs that differ by one piece, and of the one with all
ABLATIONS: dict[str, dict[str, Any]] = {
    "all pieces": {},
    "no polarisation loss": {"weight_polarisation": 0.0},
    "polarisation / 2": {"weight_polarisation": 4.0},
    "polarisation x 2": {"weight_polarisation": 16.0},
    "no depth-normal": {"weight_depth_normal": 0.0},
    "no smoothness": {"weight_smooth": 0.0},
    "priors x 4": {"weight_smooth": 0.08, "weight_depth_normal": 0.24},
    "split sum": {"mirror": "split"},
    "22000 splats": {"max_splats": 22000, "splat_pixels": 1.15},
    "Schlick": {"fresnel": "schlick"},
    "GGX lobe": {"lobe": "ggx"},
    "no indirect light": {"indirect": "none"},
    "environment 16": {"environment_resolution": 16},
    "environment 64": {"environment_resolution": 64},
}

NO_CONCAVITIES = "no concavities"  # to be held against the run "stokes"


def sources_of(folder: Path, scratch: Path) -> tuple[list[Any], str, str]:
    """Decoded views of a capture (through the pipeline's own stages), their mode and the up axis."""
    from pipeline.capture import open_capture
    from pipeline.engine.plan import load_stages
    from pipeline.engine.stage import StageRun
    from stages.train.views.source_views import load_sources

    capture = open_capture(folder)
    modules = {"decode": "stages.calib.decode", "poses": "stages.calib.poses", "masks": "stages.masks"}
    stages = load_stages(modules)
    done: dict[str, Path] = {}
    for name in modules:
        out = scratch / folder.name / name
        if not out.exists():
            (scratch / "work").mkdir(parents=True, exist_ok=True)
            out.mkdir(parents=True)
            stages[name].run(StageRun(capture, stages[name].parameters(), dict(done), out, scratch / "work"))
        done[name] = out
    sources, mode = load_sources(done["decode"], done["poses"], done["masks"], "auto")
    return sources, mode, capture.up


def behind_polarisers(sources: list[Any]) -> list[Any]:
    """The same views as intensities behind two ideal polarisers, even views one and odd views the other."""
    out = []
    for k, s in enumerate(sources):
        name = sorted(ANGLES_DEG)[k % 2]
        t = np.radians(2 * ANGLES_DEG[name])
        image = 0.5 * (s.image[:, :, 0] + np.cos(t) * s.image[:, :, 1] + np.sin(t) * s.image[:, :, 2])
        camera = replace(s.camera, name=name)
        out.append(replace(s, camera=camera, image=image[:, :, None].astype(np.float32)))
    return out


def as_mode(sources: list[Any], mode: str) -> list[Any]:
    """The views as this mode would have recorded them."""
    if mode == "polarisers":
        return behind_polarisers(sources)
    return [replace(s, image=s.image[:, :, :1]) for s in sources] if mode == "none" else sources


def figures(trainer: Any, sources: list[Any], truth: list[Any], folder: Path) -> dict[str, float]:
    """PSNR, normal, DoLP, material and environment errors on the test views against full Stokes truth and gt/."""
    import torch

    from pipeline.formats.images import read_image
    from pipeline.optics.stokes import degree
    from pipeline.shading import latlong
    from stages.train.evaluate import psnr
    from stages.train.render_view import mean_normals
    from stages.train.views.view import prepare

    openings = any(view.openings > 0 for view in trainer.pyramids[0])
    values: dict[str, list[float]] = {}
    with torch.no_grad():
        trainer.renderer.trace_surface(trainer.renderer.light(), trainer.scene.model.activated())
        for k, (source, true) in enumerate(zip(sources, truth)):
            if source.split != "test":
                continue
            blank = replace(source, mask=np.ones_like(source.mask), valid=np.ones_like(source.valid))
            view = prepare(blank, trainer.frame, True, trainer.scene.model["position"].device)
            rendered = trainer.renderer.render_whole(view)
            full = (source.mask > 0.99).reshape(-1)
            stokes = rendered.stokes.cpu() / trainer.frame.exposure
            target = torch.as_tensor(true.image.reshape(-1, *true.image.shape[2:]))
            values.setdefault("psnr_srgb", []).append(psnr(stokes[:, 0], target[:, 0], 1.0))
            values.setdefault("psnr_foreground", []).append(psnr(stokes[full, 0], target[full, 0], 1.0))
            greys = [s.mean(-1)[full] for s in (stokes, target)]
            dolp = [degree(torch.cat((s[:, :1].clamp_min(1e-4), s[:, 1:]), -1)) for s in greys]
            values.setdefault("dolp_mae", []).append(float((dolp[0] - dolp[1]).abs().mean()))
            path = folder / "gt" / "normal" / f"{k:03d}.exr"
            if path.exists():
                normal = read_image(path, ("X", "Y", "Z")).reshape(-1, 3)[full]
                shown = mean_normals(trainer.scene.model.activated(), view, trainer.renderer.backend, openings)
                shown = torch.where((shown != 0).any(-1, keepdim=True), shown, rendered.gbuffer.normal)
                ours = trainer.frame.directions_to_world(shown.cpu().numpy()[full])
                cosine = (normal * ours).sum(-1) / np.maximum(np.linalg.norm(normal, axis=-1), 1e-9)
                values.setdefault("normal_mae_deg", []).append(float(np.degrees(np.arccos(np.clip(cosine, -1, 1))).mean()))
            values.setdefault("ior", []).append(float(rendered.gbuffer.ior[full].mean()))
            values.setdefault("roughness", []).append(float(rendered.gbuffer.roughness[full].mean()))
    out = {name: float(np.mean(v)) for name, v in values.items()}
    env = folder / "gt" / "env.hdr"
    if env.exists():
        cube = trainer.scene.environment.radiance().detach().cpu().double().numpy() / trainer.frame.exposure
        ours = torch.as_tensor(latlong.from_cube(cube, 64, 128).astype(np.float32))
        true_map = read_image(env)[..., :3]
        fy, fx = true_map.shape[0] // 64, true_map.shape[1] // 128
        small = true_map[: 64 * fy, : 128 * fx].reshape(64, fy, 128, fx, 3).mean((1, 3))
        out["env_psnr"] = psnr(ours, torch.as_tensor(small), 1.0)
    return out


def train_once(
    sources: list[Any],
    truth: list[Any],
    mode: str,
    up: str,
    folder: Path,
    changes: dict[str, Any],
    looks: int,
    device: str = "cpu",
) -> dict[str, Any]:
    """One run: figures at `looks` moments against training seconds (looking is not timed)."""
    import torch

    from pipeline.capture.model import PolariserPrior
    from pipeline.engine.progress import Progress
    from stages.train.angle_search import search_angles
    from stages.train.parameters import TrainParameters
    from stages.train.setup import prepare_training
    from stages.train.trainer import Trainer

    torch.set_num_threads(1)
    parameters = replace(TrainParameters(), **changes)
    begin = time.perf_counter()
    priors = {name: PolariserPrior() for name in ANGLES_DEG} if mode == "polarisers" else {}
    start = prepare_training(sources, mode, priors, up, parameters, device)  # type: ignore[arg-type]
    if start.scene.bank is not None:
        for name, angle in search_angles(sources, priors, sorted(ANGLES_DEG), up, parameters, Progress()).items():
            start.scene.bank.set_angle(name, float(np.radians(angle)))
    trainer = Trainer(start.scene, start.pyramids, mode, start.frame, parameters, device)  # type: ignore[arg-type]
    spent = time.perf_counter() - begin
    marks = {round(trainer.parameters.iterations * (k + 1) / looks) for k in range(looks)}
    curve = []
    while trainer.iteration < trainer.parameters.iterations:
        begin = time.perf_counter()
        trainer.step()
        spent += time.perf_counter() - begin
        if trainer.iteration in marks:
            row = {"iteration": trainer.iteration, "train_s": round(spent, 2)} | figures(trainer, sources, truth, folder)
            curve.append(row)
            print("   ", {k: round(v, 3) for k, v in row.items()}, flush=True)
    result: dict[str, Any] = {"parameters": asdict(parameters), "curve": curve, "splats": len(trainer.scene.model)}
    result["hollowed"] = [round(share, 4) for share in trainer.upkeep.hollowed]
    if trainer.scene.bank is not None:
        states = trainer.scene.bank.result()
        result["angle_error_deg"] = {n: abs((states[n].angle_deg - t + 90) % 180 - 90) for n, t in ANGLES_DEG.items()}
        print("    angles", {n: round(e, 2) for n, e in result["angle_error_deg"].items()}, flush=True)
    return result


def plot(results: dict[str, Any], path: Path) -> None:
    """One row a capture: PSNR, normal error and environment PSNR against seconds; modes solid, ablations dashed."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    columns = ("psnr_srgb", "psnr_foreground", "normal_mae_deg", "env_psnr")
    figure, axes = pyplot.subplots(len(results), 4, figsize=(18, 4 * len(results)), squeeze=False)
    for row, (capture, runs) in zip(axes, results.items()):
        for axis, column in zip(row, columns):
            for name, run in runs.items():
                points = [(r["train_s"], r[column]) for r in run["curve"] if column in r]
                if points:
                    axis.plot(*zip(*points), "o-" if name in MODES else ".--", label=name)
            axis.set(title=f"{capture}: {column}", xlabel="training seconds")
        row[0].legend(fontsize=7)
    figure.tight_layout()
    figure.savefig(path, dpi=90)


def save(results: dict[str, Any], out: Path) -> None:
    """Write figures and pictures of what has been run so far."""
    import torch

    machine = {
        "gpu": torch.cuda.get_device_name() if torch.cuda.is_available() else None,
        "cpu": platform.processor() or platform.machine(),
        "cores": os.cpu_count(),
    }
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    report = {"machine": machine, "peak_rss_mb": peak, "captures": results}
    (out / "train.json").write_text(json.dumps(report, indent=1) + "\n")
    plot(results, out / "train.png")


def main() -> None:
    """Run what was asked for, writing after each run."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--captures", type=Path, default=os.environ.get("POLARFIELD_CAPTURES"))
    parser.add_argument("--out", type=Path, default=Path("build/bench"))
    parser.add_argument("--only", nargs="*", default=[], help="capture names")
    parser.add_argument("--iterations", type=int, default=0, help="steps a run; 0 = the default")
    parser.add_argument("--device", choices=("cpu", "cuda"), default="cpu", help="what trains")
    parser.add_argument("--quick", action="store_true", help="modes only, no ablations")
    parser.add_argument("--resume", action="store_true", help="keep runs of today's parameters in OUT/train.json")
    arguments = parser.parse_args()
    if arguments.captures is None:
        parser.error("say where the captures are: --captures DIR or POLARFIELD_CAPTURES")
    if arguments.device == "cuda":
        refuse_missing_cuda()
    arguments.out.mkdir(parents=True, exist_ok=True)
    fixed = {"iterations": arguments.iterations} if arguments.iterations else {}
    results: dict[str, Any] = {}
    if arguments.resume and (arguments.out / "train.json").exists():
        results = json.loads((arguments.out / "train.json").read_text())["captures"]
    for folder in sorted(p for p in Path(arguments.captures).iterdir() if (p / "gt" / "normal").is_dir()):
        if arguments.only and folder.name not in arguments.only:
            continue
        truth, mode, up = sources_of(folder, arguments.out / "train-inputs")
        if mode != "stokes":
            continue
        jobs = planned(fixed)
        earlier = results.get(folder.name, {})
        runs = results[folder.name] = {n: run for n, run in earlier.items() if n in jobs and made_today(run, jobs[n][1])}
        for name, (as_what, changes) in jobs.items():
            if name in runs or (arguments.quick and name not in MODES):
                continue
            if name == NO_CONCAVITIES and not found_concavities(runs["stokes"]):
                continue  # there is nothing to switch off
            print(f"{folder.name}: {name}", flush=True)
            runs[name] = train_once(as_mode(truth, as_what), truth, as_what, up, folder, changes, 4, arguments.device)
            save(results, arguments.out)
    save(results, arguments.out)


def planned(fixed: dict[str, Any]) -> dict[str, tuple[str, dict[str, Any]]]:
    """Every run by name: the mode of its data, and how its parameters differ from the defaults; `fixed` are those of all."""
    jobs: dict[str, tuple[str, dict[str, Any]]] = {mode: (mode, fixed) for mode in MODES}
    jobs[NO_CONCAVITIES] = ("stokes", {"concavities": "off"} | fixed)
    return jobs | {name: ("stokes", {"iterations": PIECES_STEPS} | changes | fixed) for name, changes in ABLATIONS.items()}


def found_concavities(run: dict[str, Any]) -> bool:
    """Whether a search moved the surface."""
    from stages.train.upkeep import LEAST_CONCAVITY

    return max(run["hollowed"], default=0.0) >= LEAST_CONCAVITY


def made_today(run: dict[str, Any], changes: dict[str, Any]) -> bool:
    """Whether a stored run had the parameters that it would have today, and says what is asked of it."""
    from stages.train.parameters import TrainParameters

    return run["parameters"] == asdict(replace(TrainParameters(), **changes)) and "hollowed" in run


if __name__ == "__main__":
    try:
        main()
    except UserError as fault:
        raise SystemExit(f"bench_train: {fault}") from None
