"""What a capture's gt/ tells of its views, cameras and lights; any of it may be absent (docs/captures.md lists the files)."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.formats.arrays import array_names, read_array
from pipeline.formats.images import XYZ, read_image
from pipeline.formats.json_file import read_json

FOLDER, MAPS = "gt", "maps.npz"
PUBLISHED_MESHES = ("smvp3d", "rmvp3d")
"""Layouts whose scenes are published with the scanned or rendered surface as NAME.obj, in the cameras' world."""
TRUE_MAPS = ("mask", "normal", "albedo", "dp_du", "specular_albedo", "sigma", "occlusion")
"""The arrays of maps.npz that are read."""


@dataclass(frozen=True)
class Truth:
    """Ground truth of a capture, looked up by view.

    Fields:
        root: the capture's folder.
        views: its VIEWs, sorted; a file of truth may be named by a view's place among them (007).
        layout: the capture's, where published data of that kind have files of their own.
    """

    root: Path
    views: tuple[str, ...]
    layout: str = ""

    def find(self, kind: str, view: str, suffix: str = "exr") -> Path | None:
        """gt/KIND/VIEW.exr, or by the view's place in sorted order (gt/KIND/007.exr)."""
        names = [view, f"{self.views.index(view):03d}"] if view in self.views else [view]
        paths = [self.root / FOLDER / kind / f"{name}.{suffix}" for name in names]
        return next((path for path in paths if path.is_file()), None)

    def view_of(self, name: str) -> str | None:
        """The view that an image gt/KIND/NAME.exr is of, by its name or its place in sorted order (007); None if of none."""
        if name in self.views:
            return name
        return next((view for k, view in enumerate(self.views) if f"{k:03d}" == name), None)

    def images(self, kind: str) -> Iterator[tuple[str, Path]]:
        """Every (view, gt/KIND/*.exr) that is of a view of this capture, by file name."""
        for path in sorted((self.root / FOLDER / kind).glob("*.exr")):
            if (view := self.view_of(path.stem)) is not None:
                yield view, path

    def normal(self, view: str) -> NDArray[np.float32] | None:
        """World normals [H, W, 3]. Raises UserError."""
        path = self.find("normal", view)
        return None if path is None else read_image(path, XYZ)

    @property
    def environment(self) -> Path:
        """The map that lit the capture."""
        return self.root / FOLDER / "env.hdr"

    @property
    def mesh(self) -> Path:
        """The object's surface: gt/mesh.ply, or the one OBJ file beside the pictures where the layout is published with it."""
        usual = self.root / FOLDER / "mesh.ply"
        if self.layout in PUBLISHED_MESHES and not usual.is_file():
            found = sorted(p for p in self.root.glob("*.obj") if not p.name.startswith("."))
            if len(found) == 1:
                return found[0]
        return usual

    def document(self, name: str) -> dict[str, Any] | None:
        """A JSON file of gt/ (or of the capture's root), None where there is none. Raises UserError if it is broken."""
        for path in (self.root / FOLDER / name, self.root / name):
            if path.is_file():
                return read_json(path, "mend or remove it")
        return None

    def polarisers(self) -> dict[str, float] | None:
        """True polariser angles by physical camera (degrees). Raises UserError."""
        table = self.document("polarisers.json")
        if table is not None:
            return {k: float(v) for k, v in table.items()}
        table = self.document("gt_lp.json")
        return None if table is None else {f"lp{i}": float(a) for i, a in enumerate(table["true_angles_deg"])}

    def files(self) -> list[Path]:
        """Every file of ground truth."""
        root = self.root
        loose = [root / "gt_brdf.json", root / "gt_lp.json", *sorted(root.glob(f"*/{FOLDER}/{MAPS}"))]
        folder = sorted(p for p in (root / FOLDER).rglob("*") if p.is_file()) if (root / FOLDER).is_dir() else []
        own = [self.mesh] if self.mesh.suffix == ".obj" else []
        return [p for p in loose if p.is_file()] + own + folder


def camera_maps(camera: Path) -> dict[str, NDArray] | None:
    """Read the true maps of a light-stage camera.

    Args:
        camera: the camera's folder in the capture.

    Returns:
        Those of `TRUE_MAPS` that the file holds, by name [H, W] or [H, W, 3]; None where there is no file.

    Raises:
        UserError: the file is damaged.
    """
    path = camera / FOLDER / MAPS
    if not path.is_file():
        return None
    return {name: read_array(path, name) for name in array_names(path) if name in TRUE_MAPS}
