"""A light stage's surface: depth of every camera from its normal map, where the cameras' normals and albedos agree."""
