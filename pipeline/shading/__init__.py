"""Light from an environment on a polarising dielectric surface (torch): cube maps, prefiltering, shading, occlusion.

cube = EnvironmentCube(32)
light = Prefilter(32).apply(cube.radiance())
shaded = shade(normal, view, albedo, roughness, ior, frame_x, frame_y, light)
"""

from .cube import cube_directions
from .environment import EnvironmentCube
from .prefilter import LightField, Prefilter
from .shading import shade
from .types import Occlusion, Shaded

__all__ = ["EnvironmentCube", "LightField", "Occlusion", "Prefilter", "Shaded", "cube_directions", "shade"]
