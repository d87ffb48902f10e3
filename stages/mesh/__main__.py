"""`python -m stages.mesh`: the mesh stage alone."""

from pipeline.cli import stage_main

stage_main("mesh")
