"""`python -m stages.masks`: the masks stage alone."""

from stages.__main__ import stage_main

stage_main("masks")
