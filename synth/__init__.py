"""Synthetic captures with known truth: path traced by Mitsuba 3 (extra `synth`), and light-stage pixels in closed form.

Independent of the code that they test and time; tests and benchmarks import this, it imports neither.
"""
