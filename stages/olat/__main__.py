"""`python -m stages.olat`: the olat stage alone."""

from pipeline.cli import stage_main

stage_main("olat")
