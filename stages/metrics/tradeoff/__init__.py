"""`polarfield tradeoff`: error against run time on a user's own capture, and which parameters to give for either."""
