"""Stored samples become floats exactly."""

import numpy as np

from pipeline.formats.sample_kernels import widen_halves


def test_every_half_float_widens_exactly():
    bits = np.arange(1 << 16, dtype=np.uint16)  # subnormals, infinities and NaNs among them
    out = np.empty(bits.size, np.float32)
    widen_halves(bits, out, out.view(np.uint32))
    np.testing.assert_array_equal(out, bits.view(np.float16).astype(np.float32))
