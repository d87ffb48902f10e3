"""One reader per capture layout; the order is that of recognition, the more specific first.

A reader is a module with a `LAYOUT: Layout`. Adding a layout is adding a file and its name here.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path

from pipeline.capture.config import CaptureConfig
from pipeline.capture.model import Capture

MODULES = (
    "open_illumination",
    "ict_light_stage",
    "phygap_mitsuba",
    "pandora",
    "rmvp3d",
    "smvp3d",
    "nerfstudio",
    "one_light_a_picture",
    "two_camera",
    "angle_stack",
    "mosaic",
    "photographs",
)


@dataclass(frozen=True)
class Layout:
    """A layout: `looks_like` is the line shown to a user; `recognise` looks at names only; `read` validates and opens."""

    name: str
    looks_like: str
    recognise: Callable[[Path], bool]
    read: Callable[[Path, CaptureConfig], Capture]


def all_layouts() -> tuple[Layout, ...]:
    """Every layout in the order of recognition."""
    return tuple(import_module(f"{__name__}.{module}").LAYOUT for module in MODULES)
