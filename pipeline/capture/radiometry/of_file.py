"""Radiometry that was found in files: what holds for one of them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

from pipeline.capture.config import RadiometryConfig


@dataclass(frozen=True)
class FoundRadiometry(RadiometryConfig):
    """capture.toml's radiometry with what the files say.

    Fields:
        factors: on radiance, by file.
        encodings: by file.
    """

    factors: Mapping[Path, float] = field(default_factory=dict)
    encodings: Mapping[Path, str] = field(default_factory=dict)


def for_file(radiometry: RadiometryConfig, path: Path) -> RadiometryConfig:
    """What holds for one file: its own encoding where one was found."""
    if isinstance(radiometry, FoundRadiometry) and radiometry.encoding is None and path in radiometry.encodings:
        return replace(radiometry, encoding=radiometry.encodings[path])
    return radiometry


def factor_of(radiometry: RadiometryConfig, path: Path) -> float:
    """Find the factor that takes a file's radiance to the usual exposure.

    Args:
        radiometry: of the capture.
        path: the file.

    Returns:
        The factor; 1 where none was found.
    """
    return radiometry.factors.get(path, 1.0) if isinstance(radiometry, FoundRadiometry) else 1.0
