"""Exposures that files' headers tell: where they differ, radiance is the sample over exposure time x ISO / f-number squared."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.capture.config import RadiometryConfig
from pipeline.capture.naming.exif import header_number
from pipeline.capture.naming.files import RAW_SUFFIXES, count, some
from pipeline.errors import UserError
from pipeline.formats.images import open_image

Levels = NDArray[np.float64]

SAME = 0.02
"""Relative difference below which two exposures are one: headers round shutter times and f-numbers to about 1 %."""
EVENED_OUT = 2.0
"""How many times more the brightness of files must vary after division than before for the headers to be disbelieved."""
TELL = "exposure_s"


@dataclass(frozen=True)
class HeaderExposure:
    """What one header says: seconds, ISO speed, f-number (None: nothing)."""

    seconds: float | None = None
    iso: float | None = None
    f_number: float | None = None

    def relative_to(self, other: HeaderExposure) -> float:
        """How much more light this exposure turns into codes, by the facts that both tell."""
        ratio = 1.0
        for name, power in (("seconds", 1), ("iso", 1), ("f_number", -2)):
            mine, theirs = getattr(self, name), getattr(other, name)
            if mine and theirs:
                ratio *= (mine / theirs) ** power
        return ratio

    def tells(self) -> tuple[bool, bool, bool]:
        """Whether seconds, ISO and f-number are there."""
        return bool(self.seconds), bool(self.iso), bool(self.f_number)

    def spoken(self) -> str:
        """As photographers write it."""
        parts = [f"{self.seconds:g} s" if self.seconds else "", f"ISO {self.iso:g}" if self.iso else ""]
        return " ".join(p for p in (*parts, f"f/{self.f_number:g}" if self.f_number else "") if p)


def exposure_of(spec: Any) -> HeaderExposure:
    """From an open image's header (OpenImageIO)."""
    speeds = ("Exif:PhotographicSensitivity", "Exif:ISOSpeedRatings", "Exif:ISOSpeed", "isoSpeed")
    return HeaderExposure(header_number(spec, "ExposureTime"), header_number(spec, *speeds), header_number(spec, "FNumber"))


def read_exposure(path: Path) -> HeaderExposure:
    """From a file's header; nothing where it has none or is not readable here (the reader says why)."""
    try:
        if path.suffix.lower() in RAW_SUFFIXES:
            from pipeline.capture.pixels.raw import raw_exposure

            return HeaderExposure(*raw_exposure(path))
        image = open_image(path)
    except UserError:
        return HeaderExposure()
    found = exposure_of(image.spec())
    image.close()
    return found


@dataclass(frozen=True)
class ExposureFindings:
    """What files are multiplied with to be as if taken with the usual exposure (absent: 1), with words for the user."""

    factors: Mapping[Path, float]
    facts: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()


def even_out(
    known: Mapping[Path, HeaderExposure], radiometry: RadiometryConfig, brightness: Callable[[Path], Levels | None]
) -> ExposureFindings:
    """Factors that undo differing exposures. None where all are equal, nothing is known, or exposure_s sets them.

    Known for some files alone, or contradicted by the pixels (`brightness`: percentiles of a file's light, None where unknown),
    they are not used, and that is said. The usual exposure, which most files have, keeps its codes.
    """
    if radiometry.exposure_s or radiometry.exif_exposure is False or len(known) < 2:
        return ExposureFindings({})
    reference = _usual(known)
    ratios = {path: exposure.relative_to(reference) for path, exposure in known.items()}
    factors = {path: 1 / ratio for path, ratio in ratios.items() if abs(math.log(ratio)) > SAME}
    if not factors:
        return ExposureFindings({})
    paths = sorted(known, key=lambda p: ratios[p])
    low, high = paths[0], paths[-1]
    span = f"{known[low].spoken()} to {known[high].spoken()}"
    silent = [p for p, exposure in known.items() if exposure.tells() != reference.tells()]
    if silent:
        line = (
            f"{low}: exposures differ between headers ({span}), and {count(silent, 'file')} ({some(p.name for p in silent)}) "
            "tell less than the others: nothing is divided out; state each in capture.toml: "
            f'radiometry.exposure_s = {{ "{low.stem}" = {known[low].seconds or 1:g}, ... }}'
        )
        return ExposureFindings({}, warnings=(line,))
    if radiometry.exif_exposure is None and _contradicted(paths, ratios, brightness):
        line = (
            f"{low}: exposures differ by {ratios[high] / ratios[low]:.3g} between headers ({span}), but the pictures are "
            "equally bright, as if that had been evened out already: nothing is divided out; check, and say which in "
            "capture.toml: radiometry.exif_exposure = true (divide) or false"
        )
        return ExposureFindings({}, warnings=(line,))
    fact = f"exposures of {span} in the headers are divided out (as if all had {reference.spoken()})"
    return ExposureFindings(factors, (fact,))


def _usual(known: Mapping[Path, HeaderExposure]) -> HeaderExposure:
    """The exposure that most files have; of equally frequent ones the middle one."""
    counts = Counter(known.values())
    most = max(counts.values())
    usual = [e for e, n in counts.items() if n == most]
    usual.sort(key=lambda e: (e.relative_to(HeaderExposure(1.0, 100.0, 1.0)), e.spoken()))
    return usual[(len(usual) - 1) // 2]


LOOKED_AT = 8
ENOUGH = 4
"""Files among which no percentile stays alike by chance."""
DARKEST, BRIGHTEST = 0.005, 0.5
"""Percentiles beyond are noise, or pressed together by tone curves and clipping, whatever the exposure."""


def _contradicted(paths: Sequence[Path], ratios: Mapping[Path, float], brightness: Callable[[Path], Levels | None]) -> bool:
    """Whether brightness (files sorted by exposure) does not follow the exposure: what hardly varies between files as they are
    (a background, the object's dark side) would vary far more if they were divided."""
    spread = np.unique(np.linspace(0, len(paths) - 1, min(LOOKED_AT, len(paths))).round().astype(int))
    found = [(levels, ratios[p]) for p, levels in ((paths[k], brightness(paths[k])) for k in spread) if levels is not None]
    if len(found) < 2:
        return False
    levels = np.array([level for level, _ in found])
    kept = (np.median(levels, 0) > DARKEST) & (np.median(levels, 0) < BRIGHTEST) & (levels.min(0) > 0)
    if not kept.any():
        return False
    logs = np.log(levels[:, kept])
    before, after = logs.std(0), (logs - np.log([[ratio] for _, ratio in found])).std(0)
    steadiest = float(before.min() if len(found) >= ENOUGH else before.max())
    return bool(after.min() > EVENED_OUT * steadiest)


def known_seconds(path: Path, view: str | None, exposure_s: Mapping[str, float]) -> float | None:
    """capture.toml's exposure of a file: by its stem, its name, or the VIEW that it belongs to."""
    for name in (path.stem, path.name, view):
        if name is not None and name in exposure_s:
            return exposure_s[name]
    return None
