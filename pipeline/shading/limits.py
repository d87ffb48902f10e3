"""Limits inside which shading is evaluated; beyond them values are clamped and gradients kept."""

from pipeline.optics.microfacet import MIN_ROUGHNESS

# Normals turned away are shaded at this cosine (89.4 degrees): beyond it nothing is visible of a real surface.
MIN_COSINE = 0.01
MAX_ROUGHNESS = 1.0
MIN_IOR = 1.0

__all__ = ["MAX_ROUGHNESS", "MIN_COSINE", "MIN_IOR", "MIN_ROUGHNESS"]
