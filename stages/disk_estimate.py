"""How much disk space the stages will take for a capture, before any has run."""

from __future__ import annotations

from collections.abc import Container

from pipeline.capture import Capture
from pipeline.capture.view_rules import TEST_EVERY
from pipeline.formats.gbuffer import CHANNELS, PARTS
from pipeline.formats.images import STOKES

MEBI = 2**20
# Compressed bytes of a float EXR value, as seen on the project's own images (zip halves noise, blacks cost nothing).
BYTES_PER_VALUE = 1.6
STOKES_CHANNELS, MAP_CHANNELS = len(STOKES), 31
MODEL_CHANNELS = len(CHANNELS) + (len(STOKES) + 3 * len(PARTS) + len(CHANNELS)) / TEST_EVERY
"""A pixel of the train stage: a G-buffer of every view, and everything of the views that are held back."""
TEXTURE_BYTES = 130
"""Of the mesh stage's textures and files by pixel of one view: an object's whole surface takes about two views' texels."""


def disk_estimate(capture: Capture, stages: Container[str]) -> list[tuple[str, float]]:
    """Estimate what the stages of a capture will leave on disk: within a factor of two for ordinary objects.

    Args:
        capture: as recognised.
        stages: those that run.

    Returns:
        Stage and megabytes, in running order.
    """
    if capture.light_stage is not None:
        pixels = sum(capture.pixels)
        per_stage = {
            "decode": 0.05, "masks": pixels / 8 / MEBI, "olat": pixels * MAP_CHANNELS * BYTES_PER_VALUE / MEBI,
            "relight": pixels * 6 * BYTES_PER_VALUE * len(capture.environments) / MEBI, "metrics": 1.0,
        }  # fmt: skip
    else:
        pixels = sum(capture.pixels)
        channels = 3 if capture.polarisation != "stokes" else STOKES_CHANNELS
        per_stage = {
            "decode": pixels * channels * BYTES_PER_VALUE / MEBI, "poses": 0.1 if capture.cameras else pixels / 4 / MEBI,
            "masks": pixels / 8 / MEBI, "train": pixels * MODEL_CHANNELS * BYTES_PER_VALUE / MEBI + 4,
            "mesh": 4.0 + pixels / max(len(capture.views), 1) * TEXTURE_BYTES / MEBI,
            "relight": pixels * (STOKES_CHANNELS + 1) * BYTES_PER_VALUE * len(capture.environments) / MEBI,
            "metrics": 3.0,
        }  # fmt: skip
        if capture.olat is not None:
            beside = dict(disk_estimate(capture.olat, ("masks", "olat")))
            per_stage |= {"masks": per_stage["masks"] + beside["masks"], "olat": beside["olat"]}
    return [(name, mb) for name, mb in per_stage.items() if name in stages]
