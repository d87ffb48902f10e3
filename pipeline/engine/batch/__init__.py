"""Many captures in one call: planned together, run side by side within a budget, gathered in one table."""
