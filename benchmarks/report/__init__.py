"""docs/benchmarks.md: error against run time of everything that was measured, from the stored results alone."""
