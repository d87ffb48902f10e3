"""Angle stacks: one picture per polariser angle, to Stokes images."""
