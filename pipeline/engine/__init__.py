"""The machinery of runs: command line, plan, settings, stages as versions in a dataset directory, progress."""
