"""`python -m stages.masks`: the masks stage alone."""

from pipeline.cli import stage_main

stage_main("masks")
