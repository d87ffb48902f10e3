"""Coefficients of Walter et al. 2007's fit of Beckmann's G1 (Eq. 27), in the precision of the arithmetic."""

from __future__ import annotations

import numpy as np
from numba import types
from numba.extending import overload

COEFFICIENTS = (3.535, 2.181, 2.276, 2.577)
_IN_FLOAT32 = tuple(np.float32(v) for v in COEFFICIENTS)


def smith_fit(x):
    """(a, b, c, d) of `(a s + b) / (s² + c s + d)` as numbers of x's kind: float32 ones leave a float64 lobe off by 5e-8."""
    return COEFFICIENTS


@overload(smith_fit, inline="always")
def _smith_fit(x):
    return (lambda x: _IN_FLOAT32) if x == types.float32 else (lambda x: COEFFICIENTS)
