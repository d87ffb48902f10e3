"""Fits with the object's shape known: which lights it hides from a pixel, and where each pixel's surface is."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pipeline.capture import Capture
from pipeline.capture.named_file import named_file
from pipeline.engine.stage import StageRun
from pipeline.errors import UserError
from pipeline.formats.ply import Ply
from pipeline.geometry.cameras import Camera
from pipeline.geometry.occluder import Occluder
from pipeline.geometry.rays import RayMesh
from pipeline.rig.light_table import LightTable
from stages.olat.reading.frame_reader import Samples
from stages.olat.reading.rig_cameras import CameraJob

KEY = "olat.geometry"
PIXELS = 4000  # whose rays to all lights are cast together
LEAST_COVERED = 0.5  # of a camera's mask that the surface fills, or it is not this object where the cameras are


def geometry_file(capture: Capture, name: str) -> Path | None:
    """The mesh that `olat.geometry` names, once read to see that it is one. Raises UserError."""
    path = named_file(capture, name, KEY)
    if path is not None and not len(Ply(path).triangles()):
        raise UserError(path, "holds no triangles", "give the mesh of this object, such as the mesh stage's mesh.ply")
    return path


def nearest_points(camera: Camera, view: NDArray[np.float64]) -> NDArray[np.float64]:
    """Where each ray passes the stage's centre [P, 3]: where the surface is, to within the object's size."""
    along = view @ camera.centre
    return camera.centre - view * along[:, None]


class KnownGeometry:
    """The object's surface in the world of the cameras."""

    def __init__(self, path: Path) -> None:
        """Raises UserError where it is no mesh."""
        ply = Ply(path)
        self.path = path
        vertices, triangles = ply.vertices(), ply.triangles()
        self._mesh, self._occluder = RayMesh(vertices, triangles), Occluder(vertices, triangles)

    def covered(self, camera: Camera, mask: NDArray[np.bool_]) -> float:
        """Share of a camera's mask [H, W] that the surface fills. Raises UserError where it fills too little of it."""
        share = float(np.isfinite(self._mesh.distance(camera.centre, camera.rays_through(np.flatnonzero(mask)))).mean())
        if share < LEAST_COVERED:
            fault = f"fills {100 * share:.0f} % of the mask of {camera.name}"
            raise UserError(self.path, fault, f"give {KEY} a mesh of this object in the world and units of the cameras")
        return share

    def applied(
        self, samples: Samples, camera: Camera, view: NDArray[np.float64], rig: LightTable, points: NDArray | None,
        part: tuple[int, int],
    ) -> tuple[Samples, NDArray[np.float64], NDArray | None]:  # fmt: skip
        """Samples, directions and places of the pixels [first, last) of `part` alone: lights that the object hides are dark in
        them (what arrives of such a light is inter-reflection), and places, where near lights need them, lie on the surface."""
        own = slice(*part)
        toward = view[own]
        hidden = self.hidden(camera, toward, rig, points is not None)
        cross, parallel = (
            np.where(hidden[..., None], side.dtype.type(0), side[:, own]) for side in (samples.cross, samples.parallel)
        )
        if points is not None:
            found, hit = self.points(camera, toward)
            points = np.where(hit[:, None], found, points[own])
        return Samples(samples.band, cross, parallel), toward, points

    def points(self, camera: Camera, view: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
        """Where the rays that come from directions `view` [P, 3] meet the surface [P, 3], and which do [P]."""
        found = self._mesh.cast(camera.centre, -view)
        distance = np.where(found.hit, found.distance, 0.0)
        return camera.centre - view * distance[:, None], found.hit

    def hidden(
        self, camera: Camera, view: NDArray[np.float64], rig: LightTable, near: bool
    ) -> NDArray[np.bool_]:  # fmt: skip
        """Which lights [N, P] the object itself hides from the pixels with directions `view` [P, 3] to the camera.

        Of lights before the surface alone: whatever comes from those behind it is inter-reflection, which is measured.
        """
        out = np.zeros((len(rig), len(view)), bool)
        for start in range(0, len(view), PIXELS):
            own = view[start : start + PIXELS]
            found = self._mesh.cast(camera.centre, -own)
            pixel = np.flatnonzero(found.hit)
            normal = found.normal[pixel].astype(np.float64)
            normal *= np.sign((normal * own[pixel]).sum(1, keepdims=True))
            place = camera.centre - own[pixel] * found.distance[pixel, None]
            towards = np.broadcast_to(rig.directions[:, None], (len(rig), len(pixel), 3))
            if near:
                towards = rig.positions[:, None] - place
                towards = towards / np.linalg.norm(towards, axis=-1, keepdims=True)
            light, which = np.nonzero((towards * normal).sum(-1) > 0)
            origins = (place + self._occluder.lift * normal)[which]
            blocked = self._occluder.blocked(origins, towards[light, which])
            out[light[blocked], start + pixel[which[blocked]]] = True
        return out


def known_geometry(stage: StageRun, jobs: Iterable[CameraJob], surface: Path | None = None) -> KnownGeometry | None:
    """The surface given, or that `olat.geometry` names, if any. Raises UserError where it is not what the cameras see."""
    path = surface or geometry_file(stage.capture, stage.parameters.geometry)
    if path is None:
        return None
    found = KnownGeometry(path)
    for job in jobs:
        stage.note(f"{job.name}.geometry_covers", round(found.covered(job.camera, job.mask), 4))
    return found
