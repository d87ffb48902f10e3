"""Limits inside which shading is evaluated; beyond them values are clamped and gradients kept."""

from pipeline.optics.microfacet import MIN_ROUGHNESS

# Normals turned away are shaded at this cosine (89.4 degrees): beyond it nothing is visible of a real surface.
MIN_COSINE = 0.01
MAX_ROUGHNESS = 1.0
MIN_IOR = 1.0

# The tree of light (`light_tree`).
# Share of all light from which on a node by the horizon is cut further: a lamp that sets is bright to the last.
BRIGHT = 0.01
# Cosine of the view below which a normal is turned away: of its lobe it would see a tail, with steep slopes and no meaning.
AWAY = 1e-3
# Sum of weights below which float32 does not divide by it.
NOTHING = 1e-25
# e^-12 of its peak is nothing: where Beckmann's lobe ends.
BECKMANN_END = 12.0

__all__ = ["AWAY", "BECKMANN_END", "BRIGHT", "MAX_ROUGHNESS", "MIN_COSINE", "MIN_IOR", "MIN_ROUGHNESS", "NOTHING"]
