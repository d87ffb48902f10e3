"""How numba kernels are compiled, kept fresh and run on all cores, and the small parts they share."""
