"""The specular lobes by name (`lobes.py` says what each is); importing this loads no kernel."""

from __future__ import annotations

WARD, BECKMANN, PRINTED, PRINTED_COSINE, GGX = range(5)
LOBES = {"ward": WARD, "beckmann": BECKMANN, "printed": PRINTED, "printed-cosine": PRINTED_COSINE, "ggx": GGX}
