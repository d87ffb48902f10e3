"""What file names and headers say: views, angles, exposures, focal lengths."""
