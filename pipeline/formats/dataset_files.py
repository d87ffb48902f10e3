"""Names of the files that a stage leaves for others to read (docs/stages.md): written and found by these alone.

A function takes the folder of the stage that wrote the file.
"""

from __future__ import annotations

from pathlib import Path

CAMERAS = "cameras.json"
MANIFEST = "manifest.json"
MASKS = "masks.json"
OLAT = "olat"
"""Folder of the masks stage's that holds those of a light stage beside a capture's views."""
POINTS = "points.ply"
MESH = "mesh.ply"
POISSON = "mesh_poisson.ply"
ASSET = "asset"
GAUSSIANS = "gaussians.ply"
LIT_SPLATS = "splats_lit.ply"
GBUFFERS, TESTS = "gbuffer", "test"
ENVIRONMENT = "env.exr"
POLARISERS = "polarisers.json"
LIGHTING = "lighting.json"
TRAIN_LOG = "train_log.csv"
FITTED_LOBE = "maps.json"
KEPT_SAMPLES = "samples.npz"
"""In a camera's folder of the olat stage: what some of its pixels measured under every light."""
TURNTABLE, PATH = "turntable", "path"
"""Folders of an environment's frames around the mesh and along given cameras; beside each its .webp and .mp4."""
DISAGREEMENT = "disagreement"
"""Folder of the mesh stage: how far each light-stage camera is from what all of them together say."""
SUMMED, ERROR = "_olat", "_error"
"""Endings of a light-stage camera's relit images: the sum of its frames, and how far its maps are from that."""


def frame(decode: Path, view: str) -> Path:
    """Name the file of a decoded view.

    Args:
        decode: folder of the decode stage, or of poses where it resampled the views.
        view: VIEW, as docs/dataset.md defines it.

    Returns:
        The EXR.
    """
    return decode / "frames" / f"{view}.exr"


def mask(masks: Path, view: str) -> Path:
    """Name the file of a mask.

    Args:
        masks: the masks stage's folder.
        view: VIEW, or a light-stage camera's name.

    Returns:
        The PNG.
    """
    return masks / f"{view}.png"


def gbuffer(train: Path, view: str) -> Path:
    """Name the file of a view's G-buffer.

    Args:
        train: the train stage's folder.
        view: VIEW.

    Returns:
        The EXR.
    """
    return train / GBUFFERS / f"{view}.exr"


def learnt_light(train: Path, view: str) -> Path:
    """Name the file of what a view's surface mirrors of the object itself, as training has learnt it (`train.indirect=sh`).

    Args:
        train: the train stage's folder.
        view: VIEW.

    Returns:
        The EXR; it exists only after such a training.
    """
    return train / "indirect" / f"{view}.exr"


def held_back_image(train: Path, view: str) -> Path:
    """Name the file of a held-back view as the model renders it: Stokes vectors, diffuse and specular part, G-buffer.

    Args:
        train: the train stage's folder.
        view: VIEW.

    Returns:
        The EXR.
    """
    return train / TESTS / f"{view}.exr"


def held_back_views(train: Path) -> list[str]:
    """List the held-back views that training rendered.

    Args:
        train: the train stage's folder.

    Returns:
        Their VIEWs, sorted.
    """
    return sorted(path.stem for path in (train / TESTS).glob("*.exr"))


def subfolders(stage: Path) -> list[Path]:
    """List the folders in a stage's folder: one a camera (olat) or an environment (relight).

    Args:
        stage: the stage's folder.

    Returns:
        The folders, sorted.
    """
    return sorted(path for path in stage.iterdir() if path.is_dir())


def relit(environment: Path, name: str, kind: str = "") -> Path:
    """Name the file of a view, or a light-stage camera, under one environment.

    Args:
        environment: the environment's folder in the relight stage's.
        name: VIEW or camera.
        kind: of a light stage also `SUMMED` (from the sum of the frames) or `ERROR`; "" is the rendering.

    Returns:
        The EXR.
    """
    return environment / f"{name}{kind}.exr"


def camera_map(camera: Path, name: str) -> Path:
    """Name the file of one fitted map of a light-stage camera.

    Args:
        camera: the camera's folder in the olat stage's.
        name: the map, such as `diffuse_albedo`.

    Returns:
        CAMERA/NAME.exr.
    """
    return camera / f"{name}.exr"
