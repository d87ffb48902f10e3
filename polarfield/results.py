"""What the stages have left in a dataset, read when it is asked for."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.engine.places import existing_dataset
from pipeline.errors import UserError, nearest
from pipeline.formats import dataset_files as files
from pipeline.formats.images import RGB, channel_names, read_exr, read_image, read_mask, read_stokes
from pipeline.formats.json_file import read_json
from pipeline.formats.ply import Ply
from pipeline.geometry.cameras import Camera, load_cameras
from pipeline.geometry.lens import frames_folder

Array = NDArray[np.float32]
AGAIN = "run the stage that makes it again"


class Results:
    """A dataset's results in use.

    Images are float32, linear, in the capture's radiance; positions and normals in its world (docs/conventions.md). Every
    method raises UserError in one line where the stage that makes it has not run, or knows no such view.
    """

    def __init__(self, folder: Path) -> None:
        self._dataset = existing_dataset("", str(folder), "open")
        self.folder = folder

    def __repr__(self) -> str:
        return f"polarfield.open({str(self.folder)!r}): {', '.join(self.stages) or 'no results yet'}"

    @property
    def stages(self) -> dict[str, Path]:
        """Folder of each stage's version in use, by name; stages that have not run are left out."""
        names = sorted(p.name for p in self.folder.iterdir() if p.is_dir() and not p.name.startswith("."))
        found = {name: self._dataset.current(name) for name in names}
        return {name: version.folder for name, version in found.items() if version is not None}

    def stage(self, name: str) -> Path:
        """The folder of a stage's version in use."""
        version = self._dataset.current(name)
        if version is None:
            raise UserError(self.folder, f"has no results of the {name} stage", f"`polarfield {name}` makes them")
        return version.folder

    def facts(self, stage: str) -> dict[str, Any]:
        """A version's manifest: parameters, seconds, memory, what the stage noted."""
        return read_json(self.stage(stage) / files.MANIFEST, AGAIN)

    @property
    def metrics(self) -> dict[str, Any]:
        """metrics.json: figures by stage."""
        return read_json(self.stage("metrics") / "metrics.json", AGAIN)

    # -- views -----------------------------------------------------------------------------------------------------

    @property
    def cameras(self) -> dict[str, Camera]:
        """Camera of each view, or of a light stage's cameras, by name: OpenCV axes, pixel centres at +0.5."""
        return load_cameras(self.stage("poses") / files.CAMERAS)

    @property
    def views(self) -> list[str]:
        """Names of all views, sorted."""
        return sorted(self.cameras)

    @property
    def test_views(self) -> list[str]:
        """Views that training did not see, sorted."""
        return files.held_back_views(self.stage("train"))

    def image(self, view: str) -> Array:
        """A view as decoded: Stokes vectors [H, W, 3 (s0 s1 s2), 3 (rgb)], or [H, W, 3] where it has no polarisation."""
        upstream = {name: self.stage(name) for name in ("decode", "poses")}
        return _stokes_or_rgb(self._of(files.frame(frames_folder(upstream), view), view, self.views))

    def mask(self, view: str) -> NDArray[np.bool_]:
        """Where a view, or a light stage's camera, shows the object [H, W]."""
        return read_mask(self._of(files.mask(self.stage("masks"), view), view, self.views))

    # -- the trained model -----------------------------------------------------------------------------------------

    def buffers(self, view: str) -> dict[str, Array]:
        """Channels [H, W] by name of a view of the model: `N.X` .. `albedo.R` .. `roughness ior alpha depth`; of a test view
        `S0.R` .. `diffuse.R` .. `specular.R` .. as well."""
        train = self.stage("train")
        held = files.held_back_image(train, view)
        return read_exr(held if held.exists() else self._of(files.gbuffer(train, view), view, self.views))

    def splats(self, lit: bool = False) -> dict[str, NDArray[np.float64]]:
        """Columns [N] by name of gaussians.ply, or of the lit ones."""
        return _columns(self.stage("train") / (files.LIT_SPLATS if lit else files.GAUSSIANS))

    @property
    def environment(self) -> Array:
        """The light that training found [256, 512, 3]: latitude-longitude, y up."""
        return read_image(self.stage("train") / files.ENVIRONMENT, RGB)

    # -- surface, light stage, relighting --------------------------------------------------------------------------

    def mesh(self) -> tuple[NDArray[np.float64], NDArray[np.int64], dict[str, NDArray[np.float64]]]:
        """Vertices [V, 3], triangles [F, 3], and every vertex property [V] by name."""
        path = self.stage("mesh") / files.MESH
        ply = Ply(path)
        return ply.vertices(), ply.triangles(), _columns(path)

    def textures(self) -> dict[str, Array]:
        """The asset's textures [H, W, C] by name, linear."""
        folder = self.stage("mesh") / files.ASSET / "textures"
        return {path.stem: read_image(path) for path in sorted(folder.glob("*.exr"))}

    def maps(self, camera: str) -> dict[str, Array]:
        """The maps [H, W, C] of a light stage's camera by name, channels as docs/dataset.md has them: `sigma` X Y."""
        olat = self.stage("olat")
        folder = self._of(olat / camera, camera, [p.name for p in files.subfolders(olat)])
        return {path.stem: read_image(path, _numbers(path)) for path in sorted(folder.glob("*.exr"))}

    @property
    def environments(self) -> list[str]:
        """Names of the maps that the object was relit under."""
        return [folder.name for folder in files.subfolders(self.stage("relight"))]

    def relit(self, environment: str, view: str) -> Array:
        """A view under a map: [H, W, 3, 3] (Stokes) or, of a light stage, [H, W, 3]."""
        folder = self._of(self.stage("relight") / environment, environment, self.environments)
        return _stokes_or_rgb(self._of(files.relit(folder, view), view, self.views))

    def _of(self, path: Path, name: str, known: list[str]) -> Path:
        """A path that must be there; `known` names are told where it is not."""
        if not path.exists():
            raise UserError(self.folder, f"holds nothing of {name!r}", nearest(name, known) if known else AGAIN)
        return path


def _stokes_or_rgb(path: Path) -> Array:
    return read_stokes(path) if "S0.R" in channel_names(path) else read_image(path, RGB)


def _numbers(path: Path) -> list[str]:
    """The channels of a map, without those that only show them as a colour."""
    names = channel_names(path)
    return [n for n in names if n not in RGB] or list(RGB)


def _columns(path: Path) -> dict[str, NDArray[np.float64]]:
    return {name: np.asarray(values, np.float64) for name, values in Ply(path).elements["vertex"].columns.items()}
