"""`python -m stages.mesh`: the mesh stage alone."""

from pipeline.engine.cli import stage_main

stage_main("mesh")
