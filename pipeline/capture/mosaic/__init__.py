"""Polarisation-sensor mosaics to Stokes images."""
