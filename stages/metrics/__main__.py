"""`python -m stages.metrics`: the metrics stage alone."""

from pipeline.cli import stage_main

stage_main("metrics")
