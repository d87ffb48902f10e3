"""Gaussians with colour by direction, as viewers of 3D Gaussian splatting know them, and the files that hold them."""
