"""`python -m stages.calib.decode`: the decode stage alone."""

from pipeline.cli import stage_main

stage_main("decode")
