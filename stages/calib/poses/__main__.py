"""`python -m stages.calib.poses`: the poses stage alone."""

from stages.__main__ import stage_main

stage_main("poses")
