"""Light-stage frames that are not linear as they lie: read as every other capture's images are, and written as linear EXR.

Half-float frames without any radiometry to apply are never touched: the olat stage streams them where they lie.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, fields, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pipeline.capture import LightStage
from pipeline.capture.config import RadiometryConfig
from pipeline.capture.naming.files import RAW_SUFFIXES
from pipeline.capture.naming.grouping import Exposure, Group
from pipeline.capture.pixels.linear import read_linear
from pipeline.capture.radiometry.found import understand
from pipeline.capture.radiometry.of_file import FoundRadiometry, factor_of
from pipeline.engine.stage import StageRun
from pipeline.errors import UserError
from pipeline.formats.images import open_image, write_exr
from stages.calib.decode.clip_level import PlateauSearch

BATCH = 2  # frames held a job: one that is made, one that is written
HALF_RANGE = 0.5
"""Of a sample's range: what a dark frame leaves of a hot pixel must be more, or the pixel is no measurement."""
OWN_WHITE = {"uint16": 65535.0, "uint8": 255.0}
FLOATS = frozenset({"half", "float", "double"})
SAME_LEVEL = 0.01
"""A white level nearer than this to the file's own is no reason to write every frame again."""
EIGHT_BITS = "8 bits a channel, taken as {}: the fits want linear 16-bit or float files; check radiometry.encoding"


@dataclass(frozen=True)
class LinearFrames:
    """Where decode put each frame; the level from which linear samples are clipped (None: none is) and their share; frames
    without light; samples that are not finite, by frame."""

    written: dict[Path, Path]
    level: float | None
    clipped_fraction: float
    clipped_frames: int
    tops: dict[Path, float]
    bad: dict[Path, int]


def frames_of(light_stage: LightStage) -> dict[Path, str]:
    """Every light's frame and its name below the capture (camNN/PASS/FRAME)."""
    found: dict[Path, str] = {}
    for name, camera in light_stage.cameras.items():
        for folder, paths in (("cross", camera.cross), ("parallel", camera.parallel)):
            found |= {path: f"{name}/{folder}/{own}" for path, own in zip(paths, _own_names(paths))}
    return found


def _own_names(paths: Sequence[Path]) -> list[str]:
    """What tells frames apart: their names, or with those of their folders where each light has one."""
    stems = [path.stem for path in paths]
    if len(set(stems)) == len(stems):
        return stems
    above = os.path.commonpath([path.parent for path in paths])
    return ["_".join(path.relative_to(above).with_suffix("").parts) for path in paths]


def radiometry_of(stage: StageRun, light_stage: LightStage) -> RadiometryConfig | None:
    """How frames are to be read, with words on what their headers tell; None where they are linear as they lie.

    Raises UserError where capture.toml tells the exposure of some frames only.
    """
    config, names = stage.capture.config, frames_of(light_stage)
    stated = _stated_factors(config.radiometry, names, config.path or stage.capture.root / "capture.toml")
    by_header = False if stated else config.radiometry.exif_exposure
    rest = replace(config, radiometry=replace(config.radiometry, exposure_s={}, exif_exposure=by_header))
    known = understand([Group(name, {None: (Exposure(path),)}) for path, name in names.items()], rest, "colour")
    for line in known.warnings:
        stage.warn(line)
    for line in known.facts:
        stage.progress.say(line)
    radiometry = known.config.radiometry
    if stated:
        own = {f.name: getattr(radiometry, f.name) for f in fields(RadiometryConfig)}
        radiometry = FoundRadiometry(**own, factors=stated)
    kinds = _kinds(names)
    if eight := [path for path in names if kinds[_kind_key(path)] == "uint8"]:
        how = "linear" if radiometry.encoding == "linear" else "sRGB"
        more = f" and {len(eight) - 1} more" if len(eight) > 1 else ""
        stage.warn(f"{min(eight)}{more}: {EIGHT_BITS.format(how)}")
    return radiometry if _changes(radiometry, set(kinds.values())) else None


def _stated_factors(radiometry: RadiometryConfig, names: dict[Path, str], toml: Path) -> dict[Path, float]:
    """1 / seconds of every frame by capture.toml: under its name, camNN/PASS/FRAME, PASS, or camNN. Raises UserError."""
    stated = radiometry.exposure_s
    if not stated:
        return {}

    def keys(path: Path, name: str) -> list[str]:
        camera, folder, _ = name.split("/")
        return [name, name.replace("/", "_"), path.stem, path.name, f"{camera}/{folder}", folder, camera]

    found = {path: next((stated[k] for k in keys(path, name) if k in stated), None) for path, name in names.items()}
    silent = [path for path, seconds in found.items() if seconds is None]
    if silent:
        fault = f"radiometry.exposure_s tells {len(found) - len(silent)} of {len(found)} frames (not {silent[0]})"
        raise UserError(toml, fault, "state all, as { cross = 0.5, parallel = 0.25 }")
    return {path: 1 / seconds for path, seconds in found.items() if seconds is not None}


def _kind_key(path: Path) -> tuple[Path, str]:
    """A pass is exported alike: its frames of one ending have samples of one kind."""
    return path.parent, path.suffix.lower()


def _kinds(names: Iterable[Path]) -> dict[tuple[Path, str], str]:
    """What samples are ("uint8", "uint16", "half", "float", ..., "raw"), by pass and ending."""
    kinds = {}
    for key, path in {_kind_key(path): path for path in names}.items():
        if path.suffix.lower() in RAW_SUFFIXES:
            kinds[key] = "raw"
            continue
        image = open_image(path)
        kinds[key] = str(image.spec().format)
        image.close()
    return kinds


def _changes(radiometry: RadiometryConfig, kinds: set[str]) -> bool:
    """Whether reading frames with these settings gives other samples than the files' own, scaled to 0..1."""
    white = radiometry.white_level
    other_white = white is not None and any(abs(white / OWN_WHITE.get(kind, 1.0) - 1) > SAME_LEVEL for kind in kinds)
    encoded = radiometry.encoding == "srgb" or ("uint8" in kinds and radiometry.encoding is None)
    stated = bool(radiometry.black_level or radiometry.dark_frame or radiometry.flat_field or radiometry.white_balance)
    factors = isinstance(radiometry, FoundRadiometry) and bool(radiometry.factors)
    return other_white or encoded or stated or factors or "raw" in kinds


def write_linear(stage: StageRun, light_stage: LightStage, radiometry: RadiometryConfig) -> LinearFrames:
    """Write every frame as linear R G B to frames/camNN/PASS/FRAME.exr. Raises UserError naming a frame at fault."""
    names = frames_of(light_stage)
    sizes = {p: (c.camera.height, c.camera.width) for c in light_stage.cameras.values() for p in (*c.cross, *c.parallel)}
    balance = np.asarray(radiometry.white_balance or (1, 1, 1), np.float32)
    kinds = set(_kinds(names).values())
    state = _Gathered(stage.output, names, balance, _half_holds(names, radiometry, balance, kinds), kinds <= FLOATS)
    title = "writing light-stage frames as linear EXR"
    with stage.progress.bar(title, len(names), "frames") as bar, ThreadPoolExecutor(max(1, stage.jobs)) as pool:
        for batch in _batches(list(names), BATCH * max(1, stage.jobs)):
            for path, out in zip(batch, pool.map(lambda p: _frame(p, radiometry, sizes[p], balance), batch)):
                state.add(path, *out)
                bar.advance()
    return state.result()


def _batches(paths: list[Path], size: int) -> Iterator[list[Path]]:
    yield from (paths[k : k + size] for k in range(0, len(paths), size))


def _half_holds(names: dict[Path, str], radiometry: RadiometryConfig, balance: NDArray[np.float32], kinds: set[str]) -> bool:
    """Whether half floats keep what the files hold: 16 bits and fewer, or halves, at most a thousandfold brighter or darker."""
    scales = [factor_of(radiometry, path) for path in names]
    fits = max(scales) * float(balance.max()) < 1e3 and min(scales) * float(balance.min()) > 1e-3
    return fits and kinds <= {"uint8", "uint16", "half", "raw"}


def _frame(
    path: Path, radiometry: RadiometryConfig, size: tuple[int, int], balance: NDArray[np.float32]
) -> tuple[NDArray[np.float32], float | None, int, float]:
    """(linear rgb [H, W, 3], the least value that a clipped sample has (None: none is clipped), bad samples, factor)."""
    image = read_linear(path, radiometry)
    rgb = np.ascontiguousarray(image.rgb(path))
    if rgb.shape[:2] != size:
        fault = f"is {rgb.shape[1]}x{rgb.shape[0]}, the camera's other frames {size[1]}x{size[0]}"
        raise UserError(path, fault, "export every frame of a camera in one size")
    factor = factor_of(radiometry, path)
    level = None
    bad = int(rgb.size - np.count_nonzero(np.isfinite(rgb)))
    if image.saturated.any():
        tops = rgb[image.saturated].max(-1)
        hot = ~(tops > HALF_RANGE * factor)  # a pixel that the dark frame alone fills
        level = float(tops[~hot].min()) * float(balance.min()) if not hot.all() else None
        if hot.any():
            where = np.flatnonzero(image.saturated)[hot]
            rgb.reshape(-1, 3)[where] = np.nan
    return rgb * balance, level, bad, factor


class _Gathered:
    """Frames as they are written, and what is remembered of them."""

    def __init__(self, output: Path, names: dict[Path, str], balance: NDArray[np.float32], half: bool, floats: bool) -> None:
        self.output, self.names, self.balance, self.half = output, names, balance, half
        self.search = PlateauSearch() if floats else None  # integers say where they end
        self.levels: list[float] = []
        self.factors: list[float] = []
        self.tops: dict[Path, float] = {}
        self.bad: dict[Path, int] = {}
        self.written: dict[Path, Path] = {}

    def add(self, path: Path, rgb: NDArray[np.float32], level: float | None, bad: int, factor: float) -> None:
        """Write a frame and remember its top."""
        target = Path("frames") / f"{self.names[path]}.exr"
        write_exr(self.output / target, {c: rgb[..., k] for k, c in enumerate("RGB")}, half=self.half)
        self.written[path] = target
        finite = np.nan_to_num(rgb, posinf=0, neginf=0)
        self.tops[path] = float(finite.max(initial=0.0))
        if self.search is not None:
            self.search.add(finite / (self.balance * np.float32(factor)))
        self.factors.append(factor)
        if level is not None:
            self.levels.append(level)
        if bad:
            self.bad[path] = bad

    def result(self) -> LinearFrames:
        """With the level of clipping: the least that a clipped sample has, in the numbers that were written."""
        plateau = self.search.level() if self.search is not None else None
        if not self.levels and plateau is not None:
            self.levels.append(plateau * min(self.factors) * float(self.balance.min()) * (1 - 2.0**-10))
        if not self.levels:
            return LinearFrames(self.written, None, 0.0, 0, self.tops, self.bad)
        level = float(np.float16(min(self.levels))) * (1 - 2.0**-10) if self.half else min(self.levels)
        over = [p for p, top in self.tops.items() if top >= level]
        return LinearFrames(self.written, level, self._share(over, level), len(over), self.tops, self.bad)

    def _share(self, over: list[Path], level: float) -> float:
        from pipeline.formats.images import image_size, read_image

        sizes = (image_size(self.output / target) for target in self.written.values())
        total = sum(3 * width * height for width, height in sizes)
        return sum(int((read_image(self.output / self.written[p]) >= level).sum()) for p in over) / max(1, total)
