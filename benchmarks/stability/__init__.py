"""`make stability`: is every formula, kernel, fit and run sound where it is hardest? One table with verdicts."""
