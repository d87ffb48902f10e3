"""`python -m stages.metrics`: the metrics stage alone."""

from pipeline.engine.cli import stage_main

stage_main("metrics")
