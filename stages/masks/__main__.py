"""`python -m stages.masks`: the masks stage alone."""

from pipeline.engine.cli import stage_main

stage_main("masks")
