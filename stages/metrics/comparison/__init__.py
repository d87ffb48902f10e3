"""`polarfield compare`: results side by side, figures and pictures."""
