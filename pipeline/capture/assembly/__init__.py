"""From files to a capture: views, cameras, masks, polarisers, environments."""
