"""Mitsuba 3 scenes: the mesh with its textures under a map, and a polarised one."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pipeline.formats.images import write_exr, write_rgb
from pipeline.optics.fresnel import normal_reflectance

from .lobes import GGX
from .surface import Asset

STEP = 1.1
"""Ratio of the roughnesses of two lobes that are mixed for what lies between: the mean's peak is 2 % over the middle lobe's."""
MOST_LOBES = 8
LEAST = 0.01  # roughness
FLAT = 0.01  # of roughness: less variation is none
LOBE = """<bsdf type="pplastic">
      <texture name="diffuse_reflectance" type="bitmap"><string name="filename" value="textures/albedo.exr"/></texture>
      {specular}
      <float name="int_ior" value="{ior:.5f}"/>
      <float name="ext_ior" value="1"/>
      <float name="alpha" value="{alpha:.5f}"/>
      <string name="distribution" value="{distribution}"/>
    </bsdf>"""
NUMBERS = """<texture name="{name}" type="bitmap">
      <string name="filename" value="textures/{file}.exr"/>
      <boolean name="raw" value="true"/>
    </texture>"""
BLEND = """<bsdf type="blendbsdf">
    {weight}
    {first}
    {second}
  </bsdf>"""
SURFACE = """  <bsdf type="normalmap" id="surface">
    <texture name="normalmap" type="bitmap">
      <string name="filename" value="textures/normal.png"/>
      <boolean name="raw" value="true"/>
    </texture>
    {lobes}
  </bsdf>"""
SCENE = """<?xml version="1.0"?>
<!-- Metres, y up. mitsuba -D envmap=other.exr -D spp=256 {name} -->
<scene version="3.0.0">
  <default name="envmap" value="environment.exr"/>
  <default name="spp" value="128"/>
  <default name="resx" value="512"/>
  <default name="resy" value="512"/>
  <integrator type="{integrator}">{inner}</integrator>
  <sensor type="perspective">
    <float name="fov" value="40"/>
    <transform name="to_world"><lookat origin="{eye}" target="{centre}" up="0, 1, 0"/></transform>
    <film type="hdrfilm">
      <integer name="width" value="$resx"/>
      <integer name="height" value="$resy"/>
      <rfilter type="box"/>
    </film>
    <sampler type="independent"><integer name="sample_count" value="$spp"/></sampler>
  </sensor>
  <emitter type="envmap"><string name="filename" value="$envmap"/></emitter>
{bsdf}
  <shape type="obj">
    <string name="filename" value="asset.obj"/>
    <ref id="surface"/>
  </shape>
</scene>
"""


def write_mitsuba(folder: Path, asset: Asset, maps: Sequence[str], environment: NDArray[np.float32] | None) -> None:
    """asset.xml (any variant), asset_polarised.xml (polarised ones: Stokes images), and environment.exr to light them with.

    Polarised plastic (Baek et al. 2018) is the model that is fitted here. Its roughness is a number in Mitsuba, so lobes of a
    few are mixed texel by texel. environment [H, W, 3]: latitude-longitude, y up; a grey one where there is none.
    """
    light = np.full((8, 16, 3), 0.5, np.float32) if environment is None else environment
    write_rgb(folder / "environment.exr", light)
    low, high = asset.position.min(0), asset.position.max(0)
    centre = (low + high) / 2
    eye = centre + np.array([0.0, 0.35, 1.0]) * 1.6 * np.linalg.norm(high - low)
    surface = SURFACE.format(lobes=_lobes(folder / "textures", asset))
    scenes = {"asset.xml": ("path", ""), "asset_polarised.xml": ("stokes", '<integrator type="path"/>')}
    for name, (integrator, inner) in scenes.items():
        said = {"integrator": integrator, "inner": inner, "name": name, "eye": _triple(eye), "centre": _triple(centre)}
        (folder / name).write_text(SCENE.format(bsdf=surface, **said))


def _lobes(textures: Path, asset: Asset) -> str:
    """The material: polarised plastics of fixed roughness, mixed by textures that are written here."""
    seen = asset.maps["coverage"][..., 0] > 0
    roughness = asset.maps["roughness"][..., 0]
    low, high = (float(x) for x in np.quantile(roughness[seen], [0.005, 0.995]))
    low = max(low, LEAST)
    count = 1 if high - low < FLAT else min(MOST_LOBES, 2 + int(np.log(high / low) / np.log(STEP)))
    nodes = np.geomspace(low, high, count) if count > 1 else np.array([(low + high) / 2])
    (largest, share), specular = asset.reflectance(), ""
    if share is not None:  # above 1 where the index is; the body's transmission is that of the median
        relative = share[..., 0] * (float(normal_reflectance(np.float64(largest)) / normal_reflectance(np.float64(asset.ior))))
        write_exr(textures / "mitsuba_specular.exr", {"Y": relative}, half=True)
        specular = NUMBERS.format(name="specular_reflectance", file="mitsuba_specular")
    shape = {"ior": asset.ior, "distribution": GGX if asset.lobe == GGX else "beckmann"}
    lobes = [LOBE.format(specular=specular, alpha=r**2, **shape) for r in nodes]
    mixed = lobes[0]
    for k, (below, above, lobe) in enumerate(zip(nodes, nodes[1:], lobes[1:])):
        share = np.clip((roughness - below) / (above - below), 0, 1)
        write_exr(textures / f"mitsuba_roughness_{k}.exr", {"Y": share}, half=True)
        mixed = BLEND.format(weight=NUMBERS.format(name="weight", file=f"mitsuba_roughness_{k}"), first=mixed, second=lobe)
    return mixed


def _triple(point: NDArray) -> str:
    return ", ".join(f"{x:.6g}" for x in point)
