"""The light stage's fits on pixels of known truth, mirror to matt, few lights to many: what is flagged good must be right."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.olat_settings import AT, SETTINGS
from benchmarks.stability.verdicts import Row
from pipeline.rig.light_table import LightTable
from pipeline.rig.lobe_names import LOBES
from pipeline.rig.map_flags import FLAGS, GOOD
from pipeline.rig.solid_angles import solid_angles
from stages.olat.pixel_fit.lobe_choice import CANDIDATES, choose
from stages.olat.pixel_fit.many_pixels import fit
from stages.olat.pixel_fit.result_layout import FLAG
from synth.olat_pixels import Pixels, angle_deg, make, rig_of, unit

PIXELS = 200
WRONG_DEG, WRONG_SHARE = 5.0, 0.5
"""A pixel flagged good is wrong where its normal is off by more than 5 degrees, or a width or the albedo by half."""
MOST_WRONG = 0.01
RHO_SPACE = 2.0  # no specular albedo is above it: the zoo's are at most 0.6
ANISOTROPIC = 0.1  # anisotropy from which a reader of the map calls a lobe anisotropic
CLIP_MARGIN = 0.98


@dataclass(frozen=True)
class Setting:
    """Pixels to make: the rig by name, and `synth.olat_pixels.make`'s options."""

    name: str
    rig: str = "346 lights"
    options: dict[str, Any] = field(default_factory=dict)


def settings() -> list[Setting]:
    """The zoo."""
    out = []
    for lobe in ("ward", "beckmann", "ggx"):
        for sigma in (0.01, 0.02, 0.03, 0.05, 0.08, 0.12, 0.2, 0.3, 0.4, 0.6, 0.8, 1.0):
            out.append(Setting(f"{lobe}, round {sigma}", options={"lobe": lobe, "sigma": (sigma, sigma)}))
        for pair in ((0.2, 0.1), (0.5, 0.05), (0.3, 0.03), (1.0, 0.1), (0.4, 0.3)):
            out.append(Setting(f"{lobe}, {pair[0]}:{pair[1]}", options={"lobe": lobe, "sigma": pair}))
        for noise in (1e-3, 3e-3, 1e-2, 3e-2):
            for sigma in (0.02, 0.1, 0.3, 0.8):
                out.append(
                    Setting(
                        f"{lobe}, round {sigma}, noise {noise:g}",
                        options={"lobe": lobe, "sigma": (sigma, sigma), "noise": noise},
                    )
                )
    for noise in (0.0, 2e-3, 1e-2):
        for rig in RIGS:
            if rig != "346 lights":
                options = {"sigma": (0.4, 0.4), "noise": noise}
                out.append(Setting(f"ward, round 0.4, noise {noise:g}", rig, options))
        for tilt in (85.0, 88.0, 89.5):
            options = {"sigma": (0.3, 0.3), "noise": noise, "tilt_deg": tilt}
            out.append(Setting(f"ward, round 0.3, views to {tilt} deg, noise {noise:g}", options=options))
    for shadow in (0.3, 0.6, 1.0):
        out.append(
            Setting(f"ward, shadow {shadow} rad, noise 0.01", options={"sigma": (0.3, 0.3), "shadow": shadow, "noise": 1e-2})
        )
    for level in (2.0, 0.8, 0.4):
        out.append(Setting(f"ward, clipped at {level}", options={"sigma": (0.3, 0.3), "clip": level}))
    for brightness in (1e-20, 1e15):
        out.append(Setting(f"ward, radiance x {brightness:g}", options={"sigma": (0.3, 0.3), "brightness": brightness}))
    return out


def _part(keep: NDArray[np.bool_]) -> LightTable:
    full = rig_of()
    directions = full.directions[keep]
    return LightTable(directions, 100 * directions, np.ones(len(directions)), solid_angles(directions))


def _cone(lights: int, degrees: float) -> LightTable:
    rng = np.random.default_rng(0)
    angle = np.radians(degrees) * np.sqrt((np.arange(lights) + 0.5) / lights)
    turn = rng.uniform(0, 2 * np.pi, lights)
    directions = np.stack((np.sin(angle) * np.cos(turn), np.sin(angle) * np.sin(turn), np.cos(angle)), -1)
    return LightTable(directions, 100 * directions, np.ones(lights), solid_angles(directions))


RIGS = {
    "346 lights": rig_of,
    "20 lights": lambda: rig_of(20),
    "5 lights": lambda: rig_of(5),
    "4 in a plane": lambda: _plane(4),
    "half a dome": lambda: _part(rig_of().directions[:, 0] > 0),
    "30 in a cone of 25 deg": lambda: _cone(30, 25.0),
    "346 in a cone of 3 deg": lambda: _cone(346, 3.0),
}


def _plane(lights: int) -> LightTable:
    angle = np.linspace(0.2, np.pi - 0.2, lights)
    directions = np.stack((np.cos(angle), 0 * angle, np.sin(angle)), -1)
    return LightTable(directions, 100 * directions, np.ones(lights), np.full(lights, 4 * np.pi / lights))


def rows() -> Iterator[Row]:
    """A row for each setting: share of good pixels, how many of them are wrong, and the errors of the others."""
    for k, setting in enumerate(settings()):
        yield _row(setting, seed=k)


def _pixels(setting: Setting, seed: int) -> tuple[Pixels, float]:
    """The samples, and the level from which they count as clipped."""
    options = dict(setting.options)
    factor = options.pop("brightness", 1.0)
    made = make(PIXELS, rig=RIGS[setting.rig](), seed=seed, **options)
    made.cross *= factor
    made.parallel *= factor
    return made, CLIP_MARGIN * options["clip"] if "clip" in options else np.inf


def _row(setting: Setting, seed: int) -> Row:
    made, level = _pixels(setting, seed)
    factor = setting.options.get("brightness", 1.0)
    cross, parallel = made.cross.astype(np.float32), made.parallel.astype(np.float32)
    start = time.perf_counter()
    found = {}
    for lobe in CANDIDATES:
        options = SETTINGS._replace(lobe=LOBES[lobe], saturation=level, irradiance=np.pi * factor)
        found[lobe] = fit(cross, parallel, made.view, made.rig, options)[0]
    seconds = time.perf_counter() - start
    rows = found[choose(found).lobe]
    good = rows[:, FLAG] == GOOD
    sigma = rows[:, AT["sigma"]]
    off = {
        "n_d": angle_deg(_or_up(rows[:, AT["diffuse_normal"]]), made.normal),
        "n_s": angle_deg(_or_up(rows[:, AT["specular_normal"]]), made.normal),
        "sigma": np.abs(sigma / made.sigma - 1).max(1),
        "rho_s": np.abs(rows[:, AT["specular_albedo"]][:, 0] / made.specular - 1),
    }  # fmt: skip
    wrong = good & is_wrong(off)
    found_anisotropic = good & (rows[:, AT["anisotropy"]].max(1) > ANISOTROPIC)
    is_round = "sigma" in setting.options and setting.options["sigma"][0] == setting.options["sigma"][1]
    faulty = faults(good, wrong, rows[:, AT["specular_albedo"]], found_anisotropic & is_round, bool(np.isfinite(rows).all()))
    flags = np.bincount(rows[:, FLAG].astype(int), minlength=len(FLAGS))
    return Row(
        part="light stage", name=setting.name, setting=setting.rig,
        figures={
            "good": float(good.mean()), "wrong": float(wrong.sum() / max(good.sum(), 1)),
            "n_d": _median(off["n_d"], good), "n_s": _median(off["n_s"], good),
            "sigma": _median(off["sigma"], good), "rho_s": _median(off["rho_s"], good),
            "ms": 1e3 * seconds / PIXELS / len(CANDIDATES),
        },
        sound=not faulty, why="; ".join(faulty),
        worst=", ".join(f"{name} {n}" for name, n in zip(FLAGS, flags) if n and name != "good"),
    )  # fmt: skip


def is_wrong(off: Mapping[str, NDArray[np.float64]]) -> NDArray[np.bool_]:
    """Which pixels are too far off, by the errors of their normals (degrees), widths and specular albedo (relative) [N]."""
    return (np.maximum(off["n_d"], off["n_s"]) > WRONG_DEG) | (np.maximum(off["sigma"], off["rho_s"]) > WRONG_SHARE)


def faults(
    good: NDArray[np.bool_], wrong: NDArray[np.bool_], albedo: NDArray[np.float64], bent: NDArray[np.bool_], finite: bool
) -> list[str]:
    """What is wrong with a setting: `wrong` and `bent` (a round lobe called anisotropic) of the `good` pixels [N], their
    specular albedo [N, 3], and whether every value is finite. One pixel is forgiven however few are good."""
    forgiven = max(MOST_WRONG * good.sum(), 1)
    most = float(albedo[good].max()) if good.any() else 0.0
    said = {
        f"{100 * wrong.sum() / max(good.sum(), 1):.1f} % of those flagged good are wrong": wrong.sum() > forgiven,
        f"a specular albedo of {most:.1e} is flagged good": most > RHO_SPACE,
        f"{bent.sum()} round lobes are called anisotropic": bent.sum() > forgiven,
        "values that are not finite": not finite,
    }
    return [fault for fault, there in said.items() if there]


def _or_up(normals: NDArray[np.float64]) -> NDArray[np.float64]:
    """Unit normals; those that were not found (0) as (0, 0, 1)."""
    none = ~(np.linalg.norm(normals, axis=1) > 0.5)
    return unit(np.where(none[:, None], (0.0, 0.0, 1.0), normals))


def _median(values: NDArray[np.float64], good: NDArray[np.bool_]) -> float:
    return float(np.median(values[good])) if good.any() else float("nan")
