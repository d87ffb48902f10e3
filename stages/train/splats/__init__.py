"""The Gaussians: parameters, surface graph, losses on the surface, optimiser, densification, occlusion."""
