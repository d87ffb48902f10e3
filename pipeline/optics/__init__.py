"""Polarised light at dielectric surfaces: pure functions for numpy, torch and jax (one source, Python array
API)."""
