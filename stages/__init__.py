"""The stages, in the order of the pipeline: name and module of each."""

STAGES = {
    "decode": "stages.calib.decode",
    "poses": "stages.calib.poses",
    "masks": "stages.masks",
    "olat": "stages.olat",
    "train": "stages.train",
    "mesh": "stages.mesh",
    "relight": "stages.relight",
    "metrics": "stages.metrics",
}
FORMATS = ("glb", "usdz", "mtlx", "obj", "mitsuba", "blender", "nerfstudio", "colmap", "splat", "maps")
"""What results are exported to."""
