"""`python -m stages.relight`: the relight stage alone."""

from stages.__main__ import stage_main

stage_main("relight")
