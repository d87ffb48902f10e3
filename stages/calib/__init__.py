"""Calibration: decode (files to linear Stokes or RGB) and poses (cameras)."""
