"""`python -m stages.train`: the train stage alone."""

from pipeline.engine.cli import stage_main

stage_main("train")
