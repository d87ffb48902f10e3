"""The fit of one pixel, step by step, and of many pixels over threads."""
