"""MaterialX with an OpenPBR surface (Academy Software Foundation, OpenPBR 1.1; MaterialX 1.39)."""

from __future__ import annotations

import xml.etree.ElementTree as xml
from collections.abc import Sequence
from pathlib import Path

from .surface import Asset
from .texture_files import COLOURS


def write_materialx(path: Path, asset: Asset, maps: Sequence[str]) -> None:
    """One material whose textures are the EXR files beside it: linear, so that no colour space is guessed."""
    document = xml.Element("materialx", version="1.39", colorspace="lin_rec709")
    graph = xml.SubElement(document, "nodegraph", name="polarfield_textures")
    inputs = {
        "base_color": ("base_color", "color3"),
        "specular_roughness": (asset.roughness_name, "float"),
        "specular_ior": ("ior", "float"),
    }
    if "anisotropy" in maps:
        inputs["specular_roughness_anisotropy"] = ("anisotropy", "float")
    for name, kind in inputs.values():
        _picture(graph, name, kind)
        xml.SubElement(graph, "output", name=f"{name}_out", type=kind, nodename=f"{name}_image")
    _picture(graph, "normal", "vector3", extension="png")
    bumped = xml.SubElement(graph, "normalmap", name="normal_map", type="vector3")
    xml.SubElement(bumped, "input", name="in", type="vector3", nodename="normal_image")
    xml.SubElement(graph, "output", name="normal_out", type="vector3", nodename="normal_map")
    surface = xml.SubElement(document, "open_pbr_surface", name="polarfield_surface", type="surfaceshader")
    _value(surface, "base_weight", "float", "1")
    _value(surface, "base_metalness", "float", "0")
    _value(surface, "specular_weight", "float", "1")
    for entry, (name, kind) in inputs.items():
        _connected(surface, entry, kind, f"{name}_out")
    _connected(surface, "geometry_normal", "vector3", "normal_out")
    material = xml.SubElement(document, "surfacematerial", name="polarfield", type="material")
    xml.SubElement(material, "input", name="surfaceshader", type="surfaceshader", nodename="polarfield_surface")
    xml.indent(document)
    path.write_text('<?xml version="1.0"?>\n' + xml.tostring(document, encoding="unicode") + "\n")


def _picture(graph: xml.Element, name: str, kind: str, extension: str = "exr") -> None:
    node = xml.SubElement(graph, "image", name=f"{name}_image", type=kind)
    entry = xml.SubElement(node, "input", name="file", type="filename", value=f"textures/{name}.{extension}")
    if name in COLOURS:
        entry.set("colorspace", "lin_rec709")


def _value(node: xml.Element, name: str, kind: str, value: str) -> None:
    xml.SubElement(node, "input", name=name, type=kind, value=value)


def _connected(node: xml.Element, name: str, kind: str, output: str) -> None:
    xml.SubElement(node, "input", name=name, type=kind, nodegraph="polarfield_textures", output=output)
