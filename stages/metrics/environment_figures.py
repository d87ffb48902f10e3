"""How near an estimated environment is to the true one: as displayed, up to a scale, and in logarithms."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pipeline.formats.images import srgb_encode

DISPLAY_HEIGHT, LOG_HEIGHT = 64, 16
LOG_FLOOR = 0.02  # radiance below which differences are of no consequence beside the sky
SCALES = np.r_[1.0, np.geomspace(0.05, 20, 121)]


def shrink(image: NDArray, height: int) -> NDArray[np.float64]:
    """Box-filtered to [height, 2 height, C]."""
    import OpenImageIO as oiio

    source = oiio.ImageBuf(np.ascontiguousarray(image, np.float32))
    roi = oiio.ROI(0, 2 * height, 0, height, 0, 1, 0, image.shape[2])
    out = oiio.ImageBufAlgo.resize(source, roi=roi, filtername="box")
    return np.asarray(out.get_pixels(oiio.FLOAT), np.float64).reshape(height, 2 * height, -1)


def row_weights(height: int) -> NDArray[np.float64]:
    """Solid angle of each row, mean 1 [height]."""
    weights = np.sin((np.arange(height) + 0.5) / height * np.pi)
    return weights / weights.mean()


def environment_figures(estimate: NDArray, truth: NDArray) -> dict[str, float]:
    """env_psnr, env_psnr_scaled (best single factor; dB) and env_log_correlation of lat-long maps [H, W, 3]."""
    e, g = (shrink(x, DISPLAY_HEIGHT) for x in (estimate, truth))
    weight = row_weights(DISPLAY_HEIGHT)[:, None, None]

    def at_scale(scale: float) -> float:
        error = float((weight * (srgb_encode(scale * e).astype(np.float64) - srgb_encode(g)) ** 2).mean())
        return float(-10 * np.log10(max(error, 1e-12)))

    logs = [np.log(shrink(np.maximum(x, 0), LOG_HEIGHT).mean(-1) + LOG_FLOOR).ravel() for x in (e, g)]
    weights = np.repeat(row_weights(LOG_HEIGHT), 2 * LOG_HEIGHT)
    c = np.cov(logs[0], logs[1], aweights=weights)
    correlation = c[0, 1] / np.sqrt(max(c[0, 0] * c[1, 1], 1e-12))  # a constant map correlates with nothing
    return {
        "env_psnr": at_scale(1.0),
        "env_psnr_scaled": max(at_scale(s) for s in SCALES),
        "env_log_correlation": float(correlation),
    }
