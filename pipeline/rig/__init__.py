"""Light rigs: published tables, solid angles, near lights, and image-based relighting from one-light-at-a-time frames."""
