"""`python -m stages.mesh`: the mesh stage alone."""

from stages.__main__ import stage_main

stage_main("mesh")
