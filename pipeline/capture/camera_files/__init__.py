"""Cameras that lie beside the images, one reader a format; each tells its entries by image name, or by order."""
