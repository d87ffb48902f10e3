"""What a pixel's row of results holds: the maps, their channels and the flags."""

from __future__ import annotations

GOOD, TOO_FEW, SATURATED, BLACK, NO_LOBE, BAD_SAMPLES, AWAY, OUTSIDE = range(8)
FLAGS = ("good", "too few lights", "saturated", "black", "no lobe", "bad samples", "facing away", "peak outside the lights")

MAPS = {
    "diffuse_albedo": ("R", "G", "B"),
    "specular_albedo": ("Y",),
    "diffuse_normal": ("X", "Y", "Z"),
    "specular_normal": ("X", "Y", "Z"),
    "normal": ("X", "Y", "Z"),
    "tangent": ("X", "Y", "Z"),
    "sigma": ("X", "Y"),
    "roughness": ("Y",),
    "anisotropy": ("Y",),
    "occlusion_d": ("Y",),
    "occlusion_s": ("Y",),
    "visibility_d": ("Y",),
    "visibility_s": ("Y",),
    "interreflection_d": ("R", "G", "B"),
    "interreflection_s": ("Y",),
    "residual": ("Y", "flag"),
}
"""Maps of one camera and their channels, in the order of a pixel's row of results."""


def columns() -> dict[str, slice]:
    """Where each map lies in a pixel's row."""
    out, at = {}, 0
    for name, channels in MAPS.items():
        out[name] = slice(at, at + len(channels))
        at += len(channels)
    return out


_AT = {name: place.start for name, place in columns().items()}
ALBEDO_D, ALBEDO_S, NORMAL_D, NORMAL_S = (
    _AT[n] for n in ("diffuse_albedo", "specular_albedo", "diffuse_normal", "specular_normal")
)
NORMAL, TANGENT, SIGMA, ROUGHNESS = (_AT[n] for n in ("normal", "tangent", "sigma", "roughness"))
ANISOTROPY, OCCLUSION_D, OCCLUSION_S = (_AT[n] for n in ("anisotropy", "occlusion_d", "occlusion_s"))
VISIBILITY_D, VISIBILITY_S = _AT["visibility_d"], _AT["visibility_s"]
INTER_D, INTER_S, RESIDUAL = (_AT[n] for n in ("interreflection_d", "interreflection_s", "residual"))
FLAG = RESIDUAL + 1
WIDTH = FLAG + 1
