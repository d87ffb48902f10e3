"""Cameras, lenses and rays."""
