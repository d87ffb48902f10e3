"""`python -m stages.metrics`: the metrics stage alone."""

from stages.__main__ import stage_main

stage_main("metrics")
