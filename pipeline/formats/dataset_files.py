"""Names of the files that a stage leaves for others to read (docs/stages.md): written and found by these alone.

A function takes the folder of the stage that wrote the file.
"""

from __future__ import annotations

from pathlib import Path

CAMERAS = "cameras.json"
MANIFEST = "manifest.json"
MASKS = "masks.json"
POINTS = "points.ply"
MESH = "mesh.ply"
ASSET = "asset"
GAUSSIANS = "gaussians.ply"
LIT_SPLATS = "splats_lit.ply"
GBUFFERS, TESTS = "gbuffer", "test"
ENVIRONMENT = "env.exr"
POLARISERS = "polarisers.json"
LIGHTING = "lighting.json"
TRAIN_LOG = "train_log.csv"
FITTED_LOBE = "maps.json"
TURNTABLE, PATH = "turntable", "path"
"""Folders of an environment's frames around the mesh and along given cameras; beside each its .webp and .mp4."""
DISAGREEMENT = "disagreement"
"""Folder of the mesh stage: how far each light-stage camera is from what all of them together say."""
SUMMED, ERROR = "_olat", "_error"
"""Endings of a light-stage camera's relit images: the sum of its frames, and how far its maps are from that."""


def frame(decode: Path, view: str) -> Path:
    """A view as decoded (or resampled by poses)."""
    return decode / "frames" / f"{view}.exr"


def mask(masks: Path, view: str) -> Path:
    """A view's or camera's mask."""
    return masks / f"{view}.png"


def gbuffer(train: Path, view: str) -> Path:
    """A view's G-buffer."""
    return train / GBUFFERS / f"{view}.exr"


def learnt_light(train: Path, view: str) -> Path:
    """What a view's surface mirrors of the object itself, where training has learnt it (`train.indirect=sh`)."""
    return train / "indirect" / f"{view}.exr"


def held_back_image(train: Path, view: str) -> Path:
    """A held-back view as the model renders it: Stokes, diffuse and specular part, G-buffer."""
    return train / TESTS / f"{view}.exr"


def held_back_views(train: Path) -> list[str]:
    """The held-back views, sorted."""
    return sorted(path.stem for path in (train / TESTS).glob("*.exr"))


def subfolders(stage: Path) -> list[Path]:
    """The folders in a stage's folder, sorted: a camera's maps (olat), an environment's images (relight)."""
    return sorted(path for path in stage.iterdir() if path.is_dir())


def relit(environment: Path, name: str, kind: str = "") -> Path:
    """A view or camera (of a light stage: SUMMED or ERROR too) under one environment; `environment`: its folder."""
    return environment / f"{name}{kind}.exr"


def camera_map(camera: Path, name: str) -> Path:
    """One fitted map of a light-stage camera; `camera`: its folder."""
    return camera / f"{name}.exr"
