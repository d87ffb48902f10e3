"""How fine a light stage's surface is made."""

FINER = 0.5
"""Of the mesh stage's `voxel_px`: normals place a surface within a tenth of a pixel, and fused pixels resolve half of one."""
MOST_TRIANGLES = 1_000_000
"""Beyond it triangles are not cut into four, and textures alone hold the detail."""
