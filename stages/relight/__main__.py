"""`python -m stages.relight`: the relight stage alone."""

from pipeline.engine.cli import stage_main

stage_main("relight")
