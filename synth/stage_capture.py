"""Light-stage capture: one camera, cross- and parallel-polarised one-light-at-a-time frames, lights.csv and gt."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.formats.images import write_exr, write_png, write_rgb

from . import mitsuba_scene
from .environments import ENVIRONMENTS
from .orbit import fibonacci_sphere, look_at
from .shape import Shape, glaze, vase

HEIGHT_CM = 24.0
LIGHT_DISTANCE_CM = 132.0
CAMERA_CM = (-147.0, 30.0, 70.0)
FULL_FRAME = (3240, 6144)  # the camera files speak of this frame; images are it scaled by height, centred
HALF_FIELD_DEG = 4.8
BOUNCES = 3  # camera, surface, one inter-reflection


@dataclass(frozen=True)
class Subject:
    """What stands on the stage, and how its frames are stored.

    Fields:
        shape: the surface.
        sigma: Beckmann widths along u and v.
        specular: reflectance of the lobe.
        textured: tangents follow the texture coordinates (else each face's first edge) and the albedo is `glaze`.
        albedo: where it is not textured.
        noise: standard deviation of a stored sample.
        clip: largest stored sample.
    """

    shape: Shape
    sigma: tuple[float, float] = (0.35, 0.35)  # 60 lights are 26 degrees apart, a narrower lobe would fall between them
    specular: float = 0.4
    textured: bool = True
    albedo: float = 0.5
    noise: float = 0.0
    clip: float = float("inf")


def make(output: Path, size: int = 96, lights: int = 60, spp: int = 36, seed: int = 0, subject: Subject | None = None) -> None:
    """Write a light-stage capture. Frames hold I_d/2 (cross) and I_d/2 + I_s/2 (parallel), irradiance pi per light.

    Args:
        output: folder.
        size: of the frames, pixels.
        lights: how many.
        spp: samples a pixel.
        seed: of noise and sampling.
        subject: what stands on the stage; None: the vase.
    """
    import mitsuba as mi

    mi.set_variant("scalar_rgb")
    subject = subject or Subject(vase())
    towards = fibonacci_sphere(lights)
    pose = look_at(np.array(CAMERA_CM))
    view = mi.load_dict(mitsuba_scene.sensor(pose, size, size, size / 2 / np.tan(np.radians(HALF_FIELD_DEG))))
    camera = output / "cam00"
    output.mkdir(parents=True, exist_ok=True)
    _write_lights(output / "lights.csv", LIGHT_DISTANCE_CM * towards)
    _write_camera(output / "cameras" / "camera00.txt", pose)
    brdf = {"sigma": list(subject.sigma), "specular": subject.specular, "note": "Beckmann alpha along u and v"}
    (output / "gt_brdf.json").write_text(json.dumps(brdf) + "\n")
    write_rgb(output / "envmaps" / "studio.hdr", ENVIRONMENTS["studio"](128))

    shape = subject.shape.scaled(HEIGHT_CM / 2)
    colour = mitsuba_scene.texture(glaze()) if subject.textured else {"type": "rgb", "value": subject.albedo}
    lambert = mitsuba_scene.load_mesh(shape, {"type": "diffuse", "reflectance": colour}, subject.textured)
    mirror: dict[str, Any] = {"type": "roughconductor", "material": "none", "distribution": "beckmann"}
    mirror["alpha_u"], mirror["alpha_v"] = subject.sigma
    mirror["specular_reflectance"] = {"type": "rgb", "value": subject.specular}
    glossy = mitsuba_scene.load_mesh(shape, mirror, subject.textured)
    covered = _write_truth(camera, lambert, view, seed, spp)
    diffuse_under, specular_under = _Lit(lambert, view), _Lit(glossy, view)
    noise = np.random.default_rng(seed)
    for index, direction in enumerate(towards):
        diffuse = diffuse_under.render(direction, seed + index, spp)
        specular = specular_under.render(direction, seed + lights + index, spp)
        for kind, image in (("cross", diffuse / 2), ("parallel", (diffuse + specular) / 2)):
            image = image * covered[..., None]
            if subject.noise > 0:
                image = image + subject.noise * noise.normal(size=image.shape)
            image = np.minimum(image, subject.clip)
            write_exr(camera / kind / f"{index:06d}.exr", {c: image[..., k] for k, c in enumerate("RGB")}, half=True)


class _Lit:
    """The object under one distant light of irradiance pi; the scene is built once, only the light turns."""

    def __init__(self, mesh: Any, view: Any) -> None:
        import mitsuba as mi

        light = {
            "type": "directional",
            "to_world": _towards(np.array([0.0, 1, 0])),
            "irradiance": {"type": "rgb", "value": float(np.pi)},
        }
        self.scene, self.view = mi.load_dict({"type": "scene", "object": mesh, "light": light}), view
        self.parameters = mi.traverse(self.scene)

    def render(self, towards: NDArray, seed: int, spp: int) -> NDArray[np.float32]:
        """Linear RGB [H, W, 3] under a light from `towards`."""
        self.parameters["light.to_world"] = _towards(towards)
        self.parameters.update()
        film = mitsuba_scene.render(
            self.scene, self.view, {"type": "path", "max_depth": BOUNCES, "hide_emitters": True}, seed, spp
        )
        return np.stack([film[c] for c in "RGB"], -1)


def _towards(direction: NDArray) -> Any:
    """Transform of a directional light that shines from `direction`."""
    import mitsuba as mi

    up = np.eye(3)[np.argmin(np.abs(direction))]
    return mi.ScalarTransform4f().look_at([0, 0, 0], (-direction).tolist(), up.tolist())


def _write_truth(camera: Path, lambert: Any, view: Any, seed: int, spp: int) -> NDArray[np.float32]:
    """Masks and gt/maps.npz (normal, mask, albedo, dp_du); returns the coverage [H, W]."""
    import mitsuba as mi

    lit = mi.load_dict({"type": "scene", "object": lambert, "light": {"type": "constant"}})
    coverage = mitsuba_scene.render(lit, view, {"type": "path", "max_depth": 2, "hide_emitters": True}, seed, spp)["A"]
    film = mitsuba_scene.render(lit, view, {"type": "aov", "aovs": "n:sh_normal,a:albedo,t:dp_du"}, seed, spp)
    share = np.maximum(coverage, 1e-6)[..., None]  # numerators are 0 where the coverage is
    normal = np.stack([film[f"n.{c}"] for c in "XYZ"], -1)
    length = np.linalg.norm(normal, axis=-1, keepdims=True)
    maps = {
        "normal": np.divide(normal, length, out=np.zeros_like(normal), where=length > 0),
        "mask": coverage,
        "albedo": np.stack([film[f"a.{c}"] for c in "RGB"], -1) / share,
        "dp_du": np.stack([film[f"t.{c}"] for c in "XYZ"], -1),
    }
    (camera / "gt").mkdir(parents=True, exist_ok=True)
    np.savez_compressed(camera / "gt" / "maps.npz", **maps)
    write_png(camera / "mask.png", coverage)
    return coverage


def _write_lights(path: Path, positions: NDArray) -> None:
    rows = [f"{k},{x:.6f},{y:.6f},{z:.6f}" for k, (x, y, z) in enumerate(positions)]
    path.write_text("\n".join(["index,x,y,z", *rows]) + "\n")


def _write_camera(path: Path, pose: NDArray) -> None:
    """Camera-to-world (OpenGL axes) and intrinsics for the full frame, in the LSX3 camera file's form."""
    width, height = FULL_FRAME
    focal = height / 2 / np.tan(np.radians(HALF_FIELD_DEG))
    lines = [
        "#focal length", f"{focal} {focal}", "#principal point", f"{width / 2} {height / 2}",
        "#resolution", f"{width} {height}", "#distortion coeffs", "0 0 0  0",
        "#camera transformation matrix 1", "Rotation Euler X Y Z (degrees): 0 0 0",
        "Translation : " + " ".join(f"{x:.8f}" for x in pose[:3, 3]), "MATRIX :",
        *(" ".join(f"{x:.8f}" for x in row) for row in pose),
    ]  # fmt: skip
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("\n".join(lines) + "\n")
