"""`python -m stages.calib.poses`: the poses stage alone."""

from pipeline.engine.cli import stage_main

stage_main("poses")
