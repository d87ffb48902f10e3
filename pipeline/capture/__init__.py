"""Recognise and validate a capture folder: `open_capture(path)`."""

from pipeline.capture.config import CaptureConfig, load_config
from pipeline.capture.model import (
    Capture,
    DecodedView,
    LightStage,
    LightStageCamera,
    LightTable,
    PolariserPrior,
    ViewSource,
)
from pipeline.capture.recognise import open_capture

__all__ = [
    "Capture",
    "CaptureConfig",
    "DecodedView",
    "LightStage",
    "LightStageCamera",
    "LightTable",
    "PolariserPrior",
    "ViewSource",
    "load_config",
    "open_capture",
]
