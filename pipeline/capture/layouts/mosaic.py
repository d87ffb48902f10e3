"""Polarisation-camera mosaics: one single-channel PNG, TIFF or raw file per view, 2x2 polarisers."""

from __future__ import annotations

from pathlib import Path

from pipeline.capture.config import CaptureConfig, MosaicConfig, load_config
from pipeline.capture.layouts import Layout
from pipeline.capture.layouts.photographs import pictures, read_as
from pipeline.capture.layouts.photographs import recognise as has_pictures
from pipeline.capture.model import Capture
from pipeline.capture.recognition.mosaic_set import mosaic_set
from pipeline.errors import UserError


def recognise(root: Path) -> bool:
    if not has_pictures(root):
        return False
    config = load_config(root)
    if config.mosaic != MosaicConfig():
        return True
    try:
        return mosaic_set(pictures(root, config).paths, config) is not None
    except UserError:  # an unreadable file: the reader that takes the folder says so
        return False


def read(root: Path, config: CaptureConfig) -> Capture:
    """Open the capture."""
    return read_as(root, config, "mosaic", "mosaic")


LAYOUT = Layout("mosaic", "images/ with single-channel 2x2 polariser mosaics (PNG, TIFF or raw)", recognise, read)
