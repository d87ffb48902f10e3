"""The olat stage's maps of every camera, read one camera at a time, as straight pinhole images cut to the object."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pipeline.capture.view_rules import FEWEST_CAMERAS
from pipeline.errors import UserError
from pipeline.formats import dataset_files as files
from pipeline.formats.given_mask import read_given
from pipeline.formats.images import RGB, XYZ, read_image
from pipeline.geometry.cameras import Camera, camera_from_frame
from pipeline.geometry.straight_camera import pinhole
from pipeline.rig.map_flags import LOBE_FLAGS, SOUND_FLAGS

from .map_view import MapView, reduced, sampled

Image = NDArray[np.float32]
MARGIN = 3  # pixels kept about the object: what a ray that misses it says
CHANNELS = {
    "normal": XYZ, "diffuse_albedo": RGB, "specular_albedo": ("Y",), "sigma": ("X", "Y"), "tangent": XYZ,
    "std_diffuse_normal": ("Y",), "std_diffuse_albedo": ("Y",), "std_specular_albedo": ("Y",), "std_sigma": ("Y",),
    "residual": ("flag",),
}  # fmt: skip


@dataclass(frozen=True)
class RigMaps:
    """One camera's maps, 0 where nothing was fitted, cut to the object's rectangle of the frame.

    Fields:
        name: of the camera.
        camera: as a straight pinhole of the rectangle.
        mask: coverage by the object. [H, W]
        maps: by name. [H, W, C]
        sound: where normal and diffuse albedo are to be trusted. [H, W]
        lobed: where the lobe is. [H, W]
        origin: the rectangle's first column and row.
        size: of the whole frame (columns, rows).
    """

    name: str
    camera: Camera
    mask: Image
    maps: dict[str, Image]
    sound: NDArray[np.bool_]
    lobed: NDArray[np.bool_]
    origin: tuple[int, int]
    size: tuple[int, int]

    def view(self) -> MapView:
        """What the search for the surface needs of it."""
        shown = self.sound[..., None]
        normal, albedo = (np.where(shown, self.maps[n], 0.0).astype(np.float64) for n in ("normal", "diffuse_albedo"))
        return MapView(self.name, self.camera, self.mask.astype(np.float64), normal, albedo)


class Rig:
    """The cameras of a light stage that have maps; iterated over, each is read anew.

    Args:
        root: the capture's folder.
        decode: the decode stage's.
        olat: with a folder of maps for each camera.
        masks: the masks stage's, if it ran.
        fewest: cameras that it takes: a surface needs FEWEST_CAMERAS.
    """

    def __init__(
        self, root: Path, decode: Path, olat: Path, masks: Path | None, fewest: int = FEWEST_CAMERAS
    ) -> None:  # fmt: skip
        """Raises UserError where fewer than `fewest` have any."""
        self._index_path = decode / "olat.json"
        self._index = json.loads(self._index_path.read_text())
        self.folder, self._masks, self._root = olat, masks, root
        self.names = [name for name in sorted(self._index["cameras"]) if (self.folder / name).is_dir()]
        if len(self.names) < fewest:
            needed = "a surface needs three" if fewest > 1 else "one is needed"
            fault = f"only {len(self.names)} cameras see the object, {needed}"
            raise UserError(root, fault, "mend the masks of the others")
        facts = self.folder / files.FITTED_LOBE
        self.lobe = str(json.loads(facts.read_text())["lobe"])

    def __len__(self) -> int:
        return len(self.names)

    def __iter__(self) -> Iterator[RigMaps]:
        for name in self.names:
            yield self.read(name)

    def read(self, name: str) -> RigMaps:
        """One camera's maps. Raises UserError."""
        entry = self._index["cameras"][name]
        camera = camera_from_frame({"file_path": name, **entry["camera"]}, {}, self._index_path)
        maps = {key: read_image(files.camera_map(self.folder / name, key), channels) for key, channels in CHANNELS.items()}
        mask = self._mask(name, entry, maps["normal"])
        flag = maps.pop("residual")[..., 0]
        fitted = maps["normal"].any(-1)
        sound, lobed = fitted & np.isin(flag, SOUND_FLAGS), fitted & np.isin(flag, LOBE_FLAGS)
        if not camera.is_pinhole:
            camera, mask, maps, (sound, lobed) = straightened(camera, mask, maps, (sound, lobed))
        rows, columns = np.nonzero(mask > 0)
        top, left = max(rows.min() - MARGIN, 0), max(columns.min() - MARGIN, 0)
        cut = np.s_[top : rows.max() + MARGIN + 1, left : columns.max() + MARGIN + 1]
        height, width = mask[cut].shape
        own = replace(camera, width=width, height=height, cx=camera.cx - left, cy=camera.cy - top)
        kept = {key: image[cut] for key, image in maps.items()}
        return RigMaps(name, own, mask[cut], kept, sound[cut], lobed[cut], (int(left), int(top)), mask.shape[::-1])

    def _mask(self, name: str, entry: dict, normal: Image) -> Image:
        made = files.mask(self._masks, name) if self._masks is not None else None
        path = made if made is not None and made.is_file() else (self._root / entry["mask"] if entry.get("mask") else None)
        if path is None:
            return np.asarray(normal.any(-1), np.float32)
        return np.asarray(read_given(Path(path)).pixels / np.float32(255), np.float32)

    def views(self, across: int) -> list[MapView]:
        """All cameras as the search for the surface sees them: the object at most about `across` pixels large."""
        found = []
        for maps in self:
            view = maps.view()
            found.append(reduced(view, -(-max(view.mask.shape) // across)))
        return found


def straightened(
    camera: Camera, mask: Image, maps: dict[str, Image], marks: tuple[NDArray[np.bool_], ...]
) -> tuple[Camera, Image, dict[str, Image], tuple[NDArray[np.bool_], ...]]:
    """Camera, mask, maps and marks as the pinhole of the same matrix and size would have seen them."""
    straight = pinhole(camera)
    rays = straight.rays() @ camera.world_to_camera[:3, :3].T
    pixels = camera.pixels_of(rays.reshape(-1, 3)) - 0.5
    shape = mask.shape
    nearest = np.round(np.nan_to_num(pixels)).astype(np.int64)
    column, row = np.clip(nearest[:, 0], 0, shape[1] - 1), np.clip(nearest[:, 1], 0, shape[0] - 1)
    seen = np.isfinite(pixels).all(-1) & (column == nearest[:, 0]) & (row == nearest[:, 1])
    turned = {key: (image[row, column] * seen[:, None]).reshape(*shape, -1) for key, image in maps.items()}
    covered: Image = (sampled(mask.astype(np.float64), pixels) * seen).reshape(shape).astype(np.float32)
    return straight, covered, turned, tuple((m[row, column] & seen).reshape(shape) for m in marks)
