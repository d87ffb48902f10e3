"""`python -m stages.relight`: the relight stage alone."""

from pipeline.cli import stage_main

stage_main("relight")
