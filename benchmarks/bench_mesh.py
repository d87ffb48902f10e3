"""The mesh stage: distance to the true surface against processor time, by voxel and by octree depth of the Poisson surface.

    python -m benchmarks.bench_mesh [--out FOLDER]

A fluted vase is seen from all around, without noise and then with half a pixel's footprint of it in every depth; what lies
between the surface and the vase is the stage's own. Every case is stored as soon as it is measured.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.case_store import CaseStore
from pipeline.capture import Capture
from pipeline.engine.progress import Progress
from pipeline.engine.stage import StageRun
from pipeline.formats import dataset_files as files
from pipeline.formats.gbuffer import SurfaceImage, channels_of, write_gbuffer
from pipeline.geometry.cameras import Camera, camera_from_opengl, save_cameras
from pipeline.geometry.rays import RayMesh
from stages.mesh.parameters import MeshParameters
from stages.mesh.run import make_mesh
from stages.metrics.mesh_figures import read_mesh, surface_figures
from synth.orbit import fibonacci_sphere, look_at
from synth.shape import vase

FILE = "mesh.json"
VIEWS, SIZE, DISTANCE, FOCAL = 24, 128, 6.0, 300.0
NOISE_PX = 0.5  # of the depths, in pixel footprints
VOXELS = (0.6, 0.8, 1.2, 1.8, 2.7, 4.0)
DEPTHS = (6, 7, 8, 9)
SAMPLES = 100_000


def main() -> None:
    """Measure what is not stored yet."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path(__file__).parent / "results")
    parser.add_argument("--captures", help="not used: the views are made here")
    now = MeshParameters()
    store = CaseStore(parser.parse_args().out / FILE, {"voxel_px": now.voxel_px, "poisson_depth": now.poisson_depth})
    with tempfile.TemporaryDirectory() as folder:
        for label, noise in (("no noise", 0.0), ("noise", NOISE_PX)):
            inputs = Path(folder) / label
            write_views(inputs, noise)
            for voxel in VOXELS:
                changes = {"voxel_px": voxel}
                run_case(store, inputs, f"{label}, voxel of {voxel} px", changes, voxel == now.voxel_px)
            for depth in DEPTHS:
                changes = {"poisson": True, "poisson_depth": depth}
                run_case(store, inputs, f"{label}, Poisson, depth {depth}", changes, depth == now.poisson_depth)
    for name, case in store.cases.items():
        print(f"{name:32s} {case['chamfer_pct']:.4f} %  {case['seconds']:.2f} s  {case['triangles']} triangles")


def run_case(store: CaseStore, inputs: Path, name: str, changes: dict[str, Any], default: bool) -> None:
    """One run of the stage, if it is not stored."""
    store.run(name, lambda: measure(inputs, changes), default)


def measure(inputs: Path, changes: dict[str, Any]) -> dict[str, Any]:
    """Distance of the surface to the true one (percent of its longest side), processor seconds, triangles."""
    with tempfile.TemporaryDirectory() as folder:
        output, scratch = Path(folder) / "output", Path(folder) / "scratch"
        output.mkdir()
        scratch.mkdir()
        parameters = MeshParameters(**{"textures": False, **changes})
        capture = Capture(inputs, "made", "multiview", "none")
        run = StageRun(capture, parameters, {"train": inputs, "poses": inputs}, output, scratch, progress=Progress(quiet=True))
        started = time.process_time()
        make_mesh(run)
        seconds = time.process_time() - started
        vertices, faces = read_mesh(output / (files.POISSON if parameters.poisson else files.MESH))
    true = vase()
    figures = surface_figures((vertices, faces), (true.vertices, true.faces), SAMPLES)
    return {**figures, "seconds": seconds, "triangles": len(faces)}


def write_views(folder: Path, noise: float) -> None:
    """G-buffers of the vase from all around, and their cameras; `noise` of the depths in pixel footprints."""
    shape, rng = vase(), np.random.default_rng(0)
    surface = RayMesh(shape.vertices, shape.faces)
    cameras = {}
    for k, direction in enumerate(fibonacci_sphere(VIEWS)):
        pose = camera_from_opengl(look_at(DISTANCE * direction))
        camera = cameras[f"{k:03d}"] = Camera(SIZE, SIZE, FOCAL, FOCAL, SIZE / 2, SIZE / 2, pose)
        rays = camera.rays()
        found = surface.cast(np.broadcast_to(camera.centre, rays.shape), rays)
        depth = np.where(found.hit, found.distance, 0) * (rays @ camera.world_to_camera[2, :3])
        depth = np.where(found.hit, depth + noise * DISTANCE / FOCAL * rng.normal(size=depth.shape), 0)
        corners = shape.normals[shape.faces[np.where(found.hit, found.triangle, 0)]]
        normal = (corners * found.weights[..., None]).sum(-2)
        normal /= np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-9)
        inside = found.hit[..., None]
        material = np.where(inside, [0.6, 0.3, 0.1, 0.4, 1.5], 0)
        image = SurfaceImage(np.where(inside, normal, 0), material, found.hit.astype(np.float32), depth)
        path = files.gbuffer(folder, f"{k:03d}")
        path.parent.mkdir(parents=True, exist_ok=True)
        write_gbuffer(path, channels_of(image))
    save_cameras(folder / files.CAMERAS, cameras)


if __name__ == "__main__":
    main()
