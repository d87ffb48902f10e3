"""Rasteriser of 2D Gaussians: `reference` (the definition), `cpu` (numba) and `cuda` (gsplat) behind one function."""

from .raster import BACKENDS, Raster, rasterize

__all__ = ["BACKENDS", "Raster", "rasterize"]
