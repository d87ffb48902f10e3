"""The specular lobes by name (`lobes.py` says what each is); importing this loads no kernel."""

from __future__ import annotations

WARD, BECKMANN, PRINTED, PRINTED_COSINE = 0, 1, 2, 3
LOBES = {"ward": WARD, "beckmann": BECKMANN, "printed": PRINTED, "printed-cosine": PRINTED_COSINE}
