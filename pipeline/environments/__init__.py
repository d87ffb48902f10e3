"""Environment maps that come with the program: computed by `synth.shipped_maps`, our own work, in the public domain (CC0 1.0).

Latitude-longitude, linear, y up. All are so bright that a white matte surface facing the brightest side has radiance 1.
"""

from __future__ import annotations

from pathlib import Path

SHIPPED = ("neutral_studio", "clear_sky", "overcast_sky", "key_and_fill")
DEFAULT = ("neutral_studio", "clear_sky")
"""What a capture without a map of its own is relit under: soft light and hard, without colour and with. Every further map
costs as much again and shows what lies between these two."""
NO_MAPS = "none"


def shipped_map(name: str) -> Path | None:
    """Find a map that comes with the program.

    Args:
        name: of `SHIPPED`.

    Returns:
        Its file; None where there is no such map.
    """
    return Path(__file__).parent / f"{name}.exr" if name in SHIPPED else None
