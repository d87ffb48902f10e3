"""Views of an asset by Cycles: run by a Python that has bpy; imports nothing of the project.

    python render_in_blender.py JOB.json

JOB: {"asset": folder, "file": "blender.py" | "asset.glb" | "asset.usdz" | "asset.obj", "environment": map, "samples": n,
"seed": n, "views": [{"matrix": 4x4 camera-to-asset (OpenGL axes, y up), "fx", "fy", "cx", "cy", "width", "height", "out": picture.exr}]}
"""

import importlib.util
import json
import math
import sys
from pathlib import Path

import bpy
from mathutils import Matrix

Z_UP = Matrix(((1, 0, 0, 0), (0, 0, -1, 0), (0, 1, 0, 0), (0, 0, 0, 1)))


def own_script(folder):
    """The asset's blender.py as a module."""
    spec = importlib.util.spec_from_file_location("asset_blender", folder / "blender.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def load(folder, file, script):
    """Bring the asset in by one of its files, as a user would."""
    path = str(folder / file)
    if file == "blender.py":
        script.load()
    elif file.endswith(".glb"):
        bpy.ops.import_scene.gltf(filepath=path)
    elif file.endswith(".usdz"):
        bpy.ops.wm.usd_import(filepath=path)
    else:
        bpy.ops.wm.obj_import(filepath=path, forward_axis="NEGATIVE_Z", up_axis="Y")


def camera(view, scene):
    """A camera of this view."""
    lens = bpy.data.cameras.new("camera")
    made = bpy.data.objects.new("camera", lens)
    scene.collection.objects.link(made)
    made.matrix_world = Z_UP @ Matrix(view["matrix"])
    longest = max(view["width"], view["height"])
    lens.sensor_fit = "HORIZONTAL" if view["width"] >= view["height"] else "VERTICAL"
    lens.angle = 2 * math.atan(longest / 2 / (view["fx"] if view["width"] >= view["height"] else view["fy"]))
    lens.shift_x = (view["width"] / 2 - view["cx"]) / longest
    lens.shift_y = (view["cy"] - view["height"] / 2) / longest
    lens.clip_start, lens.clip_end = 1e-3, 1e6
    scene.camera = made
    scene.render.resolution_x, scene.render.resolution_y = view["width"], view["height"]


def main():
    """Render every view of the job."""
    job = json.loads(Path(sys.argv[-1]).read_text())
    folder = Path(job["asset"])
    for old in list(bpy.data.objects):
        bpy.data.objects.remove(old)
    script = own_script(folder)
    load(folder, job["file"], script)
    script.light(job["environment"])
    scene = bpy.context.scene
    scene.render.engine = "CYCLES"
    scene.cycles.samples, scene.cycles.use_denoising = job["samples"], False
    scene.cycles.max_bounces = 4
    scene.cycles.seed = job.get("seed", 0)
    scene.cycles.sample_clamp_indirect = 0
    scene.render.filter_size = 1.0
    scene.cycles.pixel_filter_type = "BOX"
    scene.render.film_transparent = True
    scene.render.threads_mode, scene.render.threads = "FIXED", job.get("threads", 2)
    settings = scene.render.image_settings
    settings.file_format, settings.color_depth = "OPEN_EXR", "32"
    for view in job["views"]:
        camera(view, scene)
        scene.render.filepath = view["out"]
        bpy.ops.render.render(write_still=True)


main()
