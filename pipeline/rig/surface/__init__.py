"""The surface of an object out of the maps of a light stage's cameras: masks, normals and albedos become one closed mesh."""
