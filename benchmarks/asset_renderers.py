"""What draws an asset, from captured cameras under a map: Mitsuba, Blender's Cycles, three.js and the report's own viewer."""

from __future__ import annotations

import json
import subprocess
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.browser_arrays import SEND, arrays_from
from pipeline.formats.images import RGB, read_image, srgb_decode
from pipeline.geometry.cameras import OPENGL_FROM_OPENCV, Camera

Views = dict[str, tuple[Camera, NDArray]]
"""Cameras by view, with their motions to the asset's frame [4, 4]."""
MITSUBA_FROM_OPENCV = np.diag([-1.0, -1.0, 1.0, 1.0])  # x left, y up, z forward


def camera_to_asset(camera: Camera, asset_from_world: NDArray) -> NDArray:
    """Rigid motion [4, 4] from the camera (OpenCV) to the asset's frame."""
    scale = np.cbrt(np.linalg.det(asset_from_world[:3, :3]))
    out = np.eye(4)
    out[:3, :3] = asset_from_world[:3, :3] / scale @ camera.camera_to_world[:3, :3]
    out[:3, 3] = asset_from_world[:3, :3] @ camera.centre + asset_from_world[:3, 3]
    return out


def by_mitsuba(asset: Path, scene: str, environment: Path, camera: Camera, pose: NDArray, samples: int, seed: int) -> NDArray:
    """Linear RGB [H, W, 3] of one view by Mitsuba 3, black beside the object."""
    import mitsuba as mi

    mi.set_variant("scalar_rgb")
    loaded = mi.load_file(str(asset / scene), envmap=str(environment), spp=samples)
    sensor = mi.load_dict({
        "type": "perspective", "to_world": mi.ScalarTransform4f(pose @ MITSUBA_FROM_OPENCV), "fov_axis": "x",
        "fov": float(np.degrees(2 * np.arctan(camera.width / 2 / camera.fx))),
        "principal_point_offset_x": camera.cx / camera.width - 0.5,
        "principal_point_offset_y": camera.cy / camera.height - 0.5,
        "near_clip": 1e-3, "far_clip": 1e6,
        "film": {"type": "hdrfilm", "width": camera.width, "height": camera.height, "rfilter": {"type": "box"}},
        "sampler": {"type": "independent", "sample_count": samples},
    })  # fmt: skip
    integrator = mi.load_dict({"type": "path", "max_depth": 5, "hide_emitters": True})
    return np.array(mi.render(loaded, sensor=sensor, integrator=integrator, spp=samples, seed=seed))[..., :3]


@dataclass(frozen=True)
class Blender:
    """A Python that has bpy, an asset's folder, samples a pixel, and where its pictures go."""

    python: str
    asset: Path
    samples: int
    out: Path


def by_blender(blender: Blender, file: str, environment: Path, views: Views, seed: int) -> dict[str, NDArray]:
    """Linear RGB [H, W, 3] of views by Cycles."""
    out = blender.out
    entries = []
    for name, (c, pose) in views.items():
        entries.append({"matrix": (pose @ OPENGL_FROM_OPENCV).tolist(), **numbers(c), "out": str(out / f"{file}-{name}.exr")})
    job = out / "job.json"
    how = {"file": file, "environment": str(environment), "samples": blender.samples, "seed": seed}
    job.write_text(json.dumps({"asset": str(blender.asset), **how, "views": entries}))
    subprocess.run(
        [blender.python, str(Path(__file__).with_name("render_in_blender.py")), str(job)], check=True, stdout=subprocess.DEVNULL
    )
    return {name: read_image(out / f"{file}-{name}.exr", RGB) for name in views}


TIMES = 4
"""Pixels a side that the browser draws for one of the picture."""


def by_three(modules: Path, glb: Path, environment: Path, views: Views) -> dict[str, NDArray]:
    """Linear RGB [H, W, 3] of views by three.js (its folder in `modules`, npm's node_modules) in headless Chromium."""
    entries = [
        {"name": name, "matrix": (pose @ OPENGL_FROM_OPENCV).tolist(), **numbers(c)} for name, (c, pose) in views.items()
    ]
    job = {"views": entries, "times": TIMES, "map": f"/map{environment.suffix}"}
    page = Path(__file__).with_name("render_in_three.html").read_text()
    page = page.replace("SEND\n", SEND + "\n", 1).replace("job = JOB", "job = " + json.dumps(job), 1)
    served: dict[str, Path | bytes] = {"/three": modules / "three", "/asset.glb": glb, job["map"]: environment}
    sent = arrays_from(page, served, list(views))
    return {name: shrunk(sent[name], camera) for name, (camera, _) in views.items()}


DRAW = """<script>(async () => {
  const root = document.getElementById('viewer'), names = NAMES;
  while (!root.viewer || !root.viewer.light) await new Promise(r => setTimeout(r, 50));
  const v = root.viewer, gl = v.model.gl;
  const light = await v.model.light(v.lights.find(l => l.name === LIGHT));
  for (const name of names) {
    const camera = v.scene.cameras.findIndex(c => c.name === name), [w, h] = v.scene.cameras[camera].size.map(x => x * TIMES);
    Object.assign(v.state, {camera, exposure: 0, shown: 'relit', polariser: null, wipe: 0, turn: 0});
    Object.assign(v.canvas, {width: w, height: h});
    v.model.draw({place: v.place(), state: v.state, light, photograph: null});
    const values = new Uint8Array(4 * w * h);
    gl.readPixels(0, 0, w, h, gl.RGBA, gl.UNSIGNED_BYTE, values);
    await send(name, Float32Array.from(values, x => x / 255));
  }
})()</script>"""


def by_viewer(report: Path, light: str, views: Views) -> dict[str, NDArray]:
    """Linear RGB [H, W, 3] of views as the page's viewer shows them under one of its maps; nothing is above display white."""
    draw = DRAW.replace("NAMES", json.dumps(list(views))).replace("LIGHT", json.dumps(light)).replace("TIMES", str(TIMES))
    page = report.read_text(encoding="utf-8").replace("</head>", SEND + "</head>", 1).replace("</body>", draw + "</body>", 1)
    sent = arrays_from(page, {}, list(views))
    return {name: shrunk(srgb_decode(sent[name]), camera) for name, (camera, _) in views.items()}


def shrunk(values: NDArray, camera: Camera) -> NDArray[np.float32]:
    """The mean [H, W, 3] of `TIMES` by `TIMES` pixels each, of linear RGBA that begins with the lowest row."""
    fine = values.reshape(camera.height, TIMES, camera.width, TIMES, 4)[::-1]
    return np.asarray(fine.mean((1, 3))[..., :3], np.float32)


def numbers(camera: Camera) -> dict[str, Any]:
    """A pinhole camera for a job in JSON."""
    return {name: getattr(camera, name) for name in ("fx", "fy", "cx", "cy", "width", "height")}
