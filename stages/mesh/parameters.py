"""Parameters of the mesh stage."""

from __future__ import annotations

from dataclasses import dataclass, field


@dataclass(frozen=True)
class MeshParameters:
    """How the depth images become a surface."""

    voxel_px: float = field(
        default=1.2, metadata={"help": "voxel edge, in pixel footprints on the object; a light stage takes half of it (px)"}
    )
    max_voxels: int = field(default=320, metadata={"help": "voxels along the object's longest side at most (count)"})
    truncation_voxels: float = field(default=6.0, metadata={"help": "truncation distance (voxels)"})
    grazing: float = field(default=0.15, metadata={"help": "least cosine between ray and normal of a depth that counts"})
    match_outlines: bool = field(
        default=True, metadata={"help": "shift the surface along its normal until outlines agree with the opacity images"}
    )
    follow_normals: float = field(
        default=4.0,
        metadata={"help": "relief smaller than this follows the rendered normals instead of the depths, 0: none (edges)"},
    )
    component_pct: float = field(default=2.0, metadata={"help": "smaller pieces than this go (percent of the largest's area)"})
    decimate: float = field(
        default=0.5,
        metadata={
            "help": "triangles go as long as the surface, and so every outline, moves by less than this; 0: none go (px)"
        },
    )
    fill_holes: bool = field(default=True, metadata={"help": "close holes that no view sees into (such as the underside)"})
    textures: bool = field(default=True, metadata={"help": "also write asset/: textures, and files that other programs open"})
    texel_px: float = field(default=1.0, metadata={"help": "side of a texel, in pixel footprints on the object (px)"})
    max_texture: int = field(default=8192, metadata={"help": "side of the largest texture (texels)"})
    poisson: bool = field(default=False, metadata={"help": "also write mesh_poisson.ply, a closed surface"})
    poisson_depth: int = field(default=8, metadata={"help": "octree depth of the Poisson surface (levels)"})

    def __post_init__(self) -> None:
        if not 0.1 <= self.voxel_px <= 10:
            raise ValueError("voxel_px must lie between 0.1 and 10")
        if not 16 <= self.max_voxels <= 2048:
            raise ValueError("max_voxels must lie between 16 and 2048")
        if not 1.5 <= self.truncation_voxels <= 50:
            raise ValueError("truncation_voxels must lie between 1.5 and 50")
        if not 0 <= self.follow_normals <= 100:
            raise ValueError("follow_normals must lie between 0 and 100")
        if not 0 <= self.decimate <= 100:
            raise ValueError("decimate must lie between 0 and 100")
        if not 0.1 <= self.texel_px <= 100:
            raise ValueError("texel_px must lie between 0.1 and 100")
        if not 64 <= self.max_texture <= 16384:
            raise ValueError("max_texture must lie between 64 and 16384")
        if not 4 <= self.poisson_depth <= 12:
            raise ValueError("poisson_depth must lie between 4 and 12")
