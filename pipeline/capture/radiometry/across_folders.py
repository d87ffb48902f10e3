"""One usual exposure for cameras whose pictures lie in folders of their own."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields, replace

from pipeline.capture.config import CaptureConfig, RadiometryConfig
from pipeline.capture.naming.grouping import Group
from pipeline.capture.radiometry.exposure import even_out, read_exposure
from pipeline.capture.radiometry.found import Understood, brightness
from pipeline.capture.radiometry.of_file import FoundRadiometry


def even_out_across(groups: Sequence[Group], config: CaptureConfig) -> Understood:
    """The settings with the factors that bring the photographs of all folders to one exposure, and words for the user.

    groups: the views of all folders. Their readers then look at no header again.
    """
    single = {e.path: e for g in groups for es in g.angles.values() if len(es) == 1 for e in es}
    radiometry = config.radiometry
    known = {path: read_exposure(path) for path in single}
    found = even_out(known, radiometry, lambda path: brightness(single[path], config, "colour"))
    if not (found.factors or found.warnings):
        return Understood(config, found.facts)
    own = {f.name: getattr(radiometry, f.name) for f in fields(RadiometryConfig)}
    settled = FoundRadiometry(**{**own, "exif_exposure": False}, factors=found.factors)
    return Understood(replace(config, radiometry=settled), found.facts, found.warnings)
