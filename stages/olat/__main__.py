"""`python -m stages.olat`: the olat stage alone."""

from pipeline.engine.cli import stage_main

stage_main("olat")
