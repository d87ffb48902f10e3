"""The published solvers, to compare the closed forms with."""
