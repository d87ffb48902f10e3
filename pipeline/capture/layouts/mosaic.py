"""Polarisation-camera mosaics: one single-channel PNG, TIFF or raw file per view, 2x2 polarisers."""

from __future__ import annotations

from pathlib import Path

from pipeline.capture.assembly.assemble import assemble
from pipeline.capture.assembly.sources import discover
from pipeline.capture.config import CaptureConfig, load_config
from pipeline.capture.layouts import Layout
from pipeline.capture.layouts.photographs import pictures
from pipeline.capture.layouts.photographs import recognise as has_pictures
from pipeline.capture.model import Capture
from pipeline.capture.mosaic.sensor_files import is_mosaic
from pipeline.errors import UserError


def recognise(root: Path) -> bool:
    if not has_pictures(root):
        return False
    config = load_config(root)
    try:
        _, paths = pictures(root)
        return is_mosaic(paths, config)
    except UserError:  # an unreadable file: the reader that takes the folder says so
        return False


def read(root: Path, config: CaptureConfig) -> Capture:
    """Open the capture."""
    folder, paths = pictures(root)
    sources = discover(paths, folder, config, lambda _: "camera", kind="mosaic")
    return assemble(root, "mosaic", config, folder, sources.views, "stokes", facts=sources.facts, warned=sources.warnings)


LAYOUT = Layout("mosaic", "images/ with single-channel 2x2 polariser mosaics (PNG, TIFF or raw)", recognise, read)
