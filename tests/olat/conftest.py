"""The fits' settings as the stage has them by default, on Ward's lobe, and pixels through them."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from pipeline.capture.config import OlatConfig
from stages.olat.parameters import OlatParameters
from stages.olat.pixel_fit.fit_options import FitOptions
from stages.olat.pixel_fit.many_pixels import fit
from stages.olat.run import settings_of
from synth.olat_pixels import Pixels


@pytest.fixture
def settings() -> FitOptions:
    return settings_of(OlatParameters(lobe="ward"), OlatConfig(), np.inf)


@pytest.fixture
def run(settings) -> Callable[..., np.ndarray]:
    """Fit pixels; changes are fields of the settings."""

    def call(p: Pixels, precision: str = "float32", **changes: object) -> np.ndarray:
        kind = np.dtype(precision)
        rows, _ = fit(p.cross.astype(kind), p.parallel.astype(kind), p.view, p.rig, settings._replace(**changes), precision)
        assert np.isfinite(rows).all()
        return rows

    return call


@pytest.fixture
def run_halves(settings) -> Callable[..., np.ndarray]:
    """The same with samples as frames of half floats hold them: that kernel is there after `make setup`."""

    def call(p: Pixels, **changes: object) -> np.ndarray:
        cross, parallel = (samples.astype(np.float16).view(np.uint16) for samples in (p.cross, p.parallel))
        rows, _ = fit(cross, parallel, p.view, p.rig, settings._replace(**changes))
        assert np.isfinite(rows).all()
        return rows

    return call
