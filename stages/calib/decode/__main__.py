"""`python -m stages.calib.decode`: the decode stage alone."""

from pipeline.engine.cli import stage_main

stage_main("decode")
