"""Light-stage frames, band by band: which pixels, in which order of lights."""
