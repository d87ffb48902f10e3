"""What a capture is, once understood: views, cameras, masks, polarisers, or a light stage. No pixels are read here."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from pipeline.capture.config import CaptureConfig
from pipeline.formats.ground_truth import Truth
from pipeline.geometry.cameras import Camera
from pipeline.rig.light_table import LightTable

Passes = Literal["both", "cross", "parallel", "none"]
"""What a light stage's camera was photographed behind: crossed and parallel polarisers, one of the two, or none."""
Polarisation = Literal["stokes", "polarisers", "none"]
"""What is known of a view's polarisation: its Stokes vectors, its radiance behind a polariser, or nothing."""


@dataclass(frozen=True)
class PolariserPrior:
    """What is known of one physical camera's polariser.

    Fields:
        angle_deg: counter-clockwise as displayed; None: unknown.
        trusted: False: the angle is a starting value, to be fitted.
        extinction: ratio of the two transmissions; None: ideal.
    """

    angle_deg: float | None = None
    trusted: bool = False
    extinction: float | None = None


@dataclass
class DecodedView:
    """One view in linear radiance: either `stokes` or `rgb`.

    Fields:
        stokes: s0, s1, s2 by R, G, B. [H, W, 3, 3]
        rgb: radiance. [H, W, 3]
        saturated: True where a sample was clipped. [H, W]
        alpha: coverage, 0..1. [H, W]
        noise: standard deviation of one stored sample, radiance; None: unknown.
        design: rows of the polariser matrix that the Stokes vector was solved from; None: the file held Stokes. [n, 3]
        covariance: of (s0, s1, s2) for samples of unit variance. [3, 3]
        faults: what was found wrong, to a pixel count (0: the fault is the file's, not of pixels).
        verbatim: an EXR that already holds exactly this, by channel name.
        moved: by how many pixels which picture of an angle stack lies off the first, where they do not fit each other.
    """

    stokes: NDArray[np.float32] | None = None
    rgb: NDArray[np.float32] | None = None
    saturated: NDArray[np.bool_] | None = None
    alpha: NDArray[np.float32] | None = None
    noise: float | None = None
    design: NDArray[np.float64] | None = None
    covariance: NDArray[np.float64] | None = None
    faults: dict[str, int] = field(default_factory=dict)
    verbatim: Path | None = None
    moved: tuple[float, Path] | None = None

    @property
    def s0(self) -> NDArray[np.float32]:
        """Total radiance (or the plain image) [H, W, 3]."""
        image = self.rgb if self.stokes is None else self.stokes[:, :, 0]
        assert image is not None, "a decoded view holds Stokes or RGB"
        return image


@dataclass(frozen=True)
class ViewSource:
    """One view before decoding.

    Fields:
        view: VIEW.
        paths: its files.
        camera: the physical camera behind it.
        loader: reads them.
        size: width, height in pixels, where known.
        paged: one file holds several images, and none of its channels is alpha.
    """

    view: str
    paths: tuple[Path, ...]
    camera: str
    loader: Callable[[], DecodedView] = field(repr=False, compare=False)
    size: tuple[int, int] | None = None
    paged: bool = False

    def read(self) -> DecodedView:
        """Decode this view. Raises UserError naming the file that is unreadable, truncated or of another size."""
        return self.loader()


@dataclass(frozen=True)
class LightStageCamera:
    """One light-stage camera.

    Fields:
        name: "camNN".
        cross, parallel: cross- and parallel-polarised frames, in the order of the lights; with one pass both are the same.
        mask: its matte's file.
        camera: pose and lens.
        full_light: frames with all lights on.
        passes: which of the two there are.
    """

    name: str
    cross: tuple[Path, ...]
    parallel: tuple[Path, ...]
    mask: Path | None
    camera: Camera
    full_light: tuple[Path, ...] = ()
    passes: Passes = "both"

    @property
    def frames(self) -> tuple[Path, ...]:
        """The frames of all passes, each once."""
        return (*self.cross, *self.parallel) if self.passes == "both" else self.cross


@dataclass(frozen=True)
class LightStage:
    """A one-light-at-a-time capture.

    Fields:
        root: its folder.
        cameras: by name, "camNN".
        lights: shared by all cameras.
    """

    root: Path
    cameras: dict[str, LightStageCamera]
    lights: LightTable


@dataclass(frozen=True)
class Capture:
    """A capture folder, understood. Nothing in it is ever written to.

    Fields:
        root: the folder.
        layout: name of the layout that recognised it.
        kind: photographs from around, or a light stage.
        polarisation: what a decoded view holds: Stokes vectors, radiance behind polarisers, or plain radiance.
        views: of a multi-view capture, sorted by VIEW.
        light_stage: its cameras and lights, where it is one.
        environments: maps to relight under.
        config: its capture.toml.
        up: the world's up axis.
        cameras: by VIEW; None: to be found.
        masks: file by view, "alpha" (the images carry it), or None.
        colmap: folder of an existing COLMAP model.
        files: every input.
        polarisers: what is known of them, by physical camera.
        warnings, facts: for people, about what was found.
        clean_plates: background photographs by physical camera or view, for masks by difference.
        parts: "train", "validation" or "test" by VIEW, where the capture's own tables divide the views.
        olat: of a multi-view capture, the light stage of the same object in its folder olat/: a capture of its own.
    """

    root: Path
    layout: str
    kind: Literal["multiview", "light_stage"]
    polarisation: Polarisation
    views: tuple[ViewSource, ...] = ()
    light_stage: LightStage | None = None
    environments: tuple[Path, ...] = ()
    config: CaptureConfig = field(default_factory=CaptureConfig)
    up: str = "y"
    cameras: dict[str, Camera] | None = None
    masks: dict[str, Path] | Literal["alpha"] | None = None
    colmap: Path | None = None
    files: tuple[Path, ...] = ()
    polarisers: dict[str, PolariserPrior] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()
    facts: tuple[str, ...] = ()
    clean_plates: dict[str, Path] = field(default_factory=dict)
    parts: dict[str, str] | None = None
    olat: Capture | None = None

    @property
    def one_light_at_a_time(self) -> Capture:
        """What of it was photographed one light at a time: the light stage beside its views where there is one, else itself."""
        return self if self.olat is None else self.olat

    @property
    def camera_names(self) -> tuple[str, ...]:
        """Physical cameras, sorted (a light stage: its camNN)."""
        if self.light_stage is not None:
            return tuple(sorted(self.light_stage.cameras))
        return tuple(sorted({view.camera for view in self.views}))

    @property
    def pixels(self) -> list[int]:
        """Pixels of every view (of a light stage: of every camera); a megapixel where its size is not known."""
        if self.light_stage is not None:
            return [c.camera.width * c.camera.height for c in self.light_stage.cameras.values()]
        cameras = self.cameras or {}
        sizes = (v.size or ((c.width, c.height) if (c := cameras.get(v.view)) else (1024, 1024)) for v in self.views)
        return [width * height for width, height in sizes]

    @property
    def camera_file(self) -> Path:
        """The file that its cameras are read from (readers list it first), else the folder."""
        pictures = {path for view in self.views for path in view.paths}
        return next((path for path in self.files if path not in pictures), self.root)

    @property
    def truth(self) -> Truth:
        """What the folder holds of ground truth."""
        return Truth(self.root, tuple(sorted(view.view for view in self.views)), self.layout)

    def view(self, name: str) -> ViewSource:
        """The view called `name`; KeyError if there is none."""
        for view in self.views:
            if view.view == name:
                return view
        raise KeyError(name)
