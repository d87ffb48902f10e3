"""`python -m stages.olat`: the olat stage alone."""

from stages.__main__ import stage_main

stage_main("olat")
