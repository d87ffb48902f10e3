"""`python -m stages.train`: the train stage alone."""

from pipeline.cli import stage_main

stage_main("train")
