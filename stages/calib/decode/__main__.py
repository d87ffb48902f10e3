"""`python -m stages.calib.decode`: the decode stage alone."""

from stages.__main__ import stage_main

stage_main("decode")
