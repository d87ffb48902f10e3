"""Tiny synthetic captures, path traced by Mitsuba 3: independent images with known truth (extra `synth`)."""
