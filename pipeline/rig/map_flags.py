"""What the flags of a light stage's pixels mean (`residual.exr`, channel `flag`)."""

from __future__ import annotations

GOOD, TOO_FEW, SATURATED, BLACK, NO_LOBE, BAD_SAMPLES, AWAY, OUTSIDE = range(8)
FLAGS = ("good", "too few lights", "saturated", "black", "no lobe", "bad samples", "facing away", "peak outside the lights")
SOUND_FLAGS = (GOOD, TOO_FEW, NO_LOBE, OUTSIDE)
"""Where the normal and the diffuse albedo are measured."""
LOBE_FLAGS = (GOOD,)
"""Where the lobe is."""
