"""Image files to linear radiance and Stokes vectors."""
