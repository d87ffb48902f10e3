"""Numbers that the shaders share with the pipeline's shading."""

from __future__ import annotations

from typing import Any

import numpy as np

from pipeline.optics import fresnel, microfacet
from pipeline.shading import limits, prefilter, prefilter_kernels

LIGHT_SIZE = 128
"""Texels along a side of an environment's octahedral map: 1.6 degrees each."""


def shading_constants() -> dict[str, Any]:
    """By the names that the shaders use."""
    low, high = fresnel.HEMISPHERICAL_RANGE
    ior = float(prefilter_kernels.REFERENCE_IOR)
    return {
        "PI": float(np.pi),
        "MIN_COSINE": limits.MIN_COSINE,
        "MIN_ROUGHNESS": microfacet.MIN_ROUGHNESS,
        "LEVELS": len(prefilter.ROUGHNESSES),
        "LEVEL_ROUGHNESS": list(prefilter.ROUGHNESSES),
        "LIGHT_SIZE": LIGHT_SIZE,
        "REFERENCE_IOR": ior,
        "REFERENCE_ENTERING": float(fresnel.hemispherical_transmittance(np.asarray(ior))),
        "HEMISPHERE": list(fresnel.HEMISPHERICAL),
        "HEMISPHERE_TERMS": len(fresnel.HEMISPHERICAL),
        "HEMISPHERE_FROM": low,
        "HEMISPHERE_TO": high,
        "HEMISPHERE_STEP": fresnel.HEMISPHERICAL_STEP,
    }
