"""What a pixel's row of results holds: the maps, their channels and the flags."""

from __future__ import annotations

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
    "std_diffuse_normal": ("Y",),
    "std_specular_normal": ("Y",),
    "std_normal": ("Y",),
    "std_diffuse_albedo": ("Y",),
    "std_specular_albedo": ("Y",),
    "std_sigma": ("Y",),
    "removed": ("cross", "parallel"),
}
"""Maps of one camera and their channels, in the order of a pixel's row of results."""
ON_REQUEST = ("removed",)
"""Those that only an option asks for: `overexposure=remove`."""


def map_slices() -> dict[str, slice]:
    """Where each map lies in a pixel's row."""
    out, at = {}, 0
    for name, channels in MAPS.items():
        out[name] = slice(at, at + len(channels))
        at += len(channels)
    return out


_AT = {name: place.start for name, place in map_slices().items()}
ALBEDO_D, ALBEDO_S, NORMAL_D, NORMAL_S = (
    _AT[n] for n in ("diffuse_albedo", "specular_albedo", "diffuse_normal", "specular_normal")
)
NORMAL, TANGENT, SIGMA, ROUGHNESS = (_AT[n] for n in ("normal", "tangent", "sigma", "roughness"))
ANISOTROPY, OCCLUSION_D, OCCLUSION_S = (_AT[n] for n in ("anisotropy", "occlusion_d", "occlusion_s"))
VISIBILITY_D, VISIBILITY_S = _AT["visibility_d"], _AT["visibility_s"]
INTER_D, INTER_S, RESIDUAL = (_AT[n] for n in ("interreflection_d", "interreflection_s", "residual"))
FLAG = RESIDUAL + 1
STD_NORMAL_D, STD_NORMAL_S, STD_NORMAL = (_AT[f"std_{n}"] for n in ("diffuse_normal", "specular_normal", "normal"))
STD_ALBEDO_D, STD_ALBEDO_S, STD_SIGMA = (_AT[f"std_{n}"] for n in ("diffuse_albedo", "specular_albedo", "sigma"))
REMOVED = _AT["removed"]
WIDTH = REMOVED + 2
