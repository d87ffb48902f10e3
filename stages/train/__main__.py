"""`python -m stages.train`: the train stage alone."""

from stages.__main__ import stage_main

stage_main("train")
