"""Reflectance maps: corrected for the pixel's footprint, and written."""
