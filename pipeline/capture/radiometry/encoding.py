"""Linear light or sRGB? Four polariser angles decide: I0 + I90 = I45 + I135 holds in linear light alone.

For each reading of the codes the Stokes vectors that fit best also tell what misfit the *other* reading must then show, pixel
by pixel (it grows with the square of the degree of polarisation). How much of that predicted misfit is there is one number,
0 or 1 as the reading is right or wrong; noise, which is not shaped like the prediction, only widens its error.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline.formats.images import srgb_decode, srgb_encode

SIGMAS = 4.0
"""Standard errors that the share must be away from one half. Decided wrongly once in 30 000 captures if errors were normal."""
FARTHEST = 0.75
"""How far beyond 0 or 1 the share may lie: farther out something else (angles, movement) is what does not fit."""
PARTS = 64
"""Regions whose scatter tells the error of the share: neighbours err alike."""
FEWEST_PARTS = 6
"""Regions of equal weight to which the regions must come at least, for their scatter to tell an error."""
CLIPPED = 0.995


@dataclass(frozen=True)
class EncodingFinding:
    """Share of the misfit that sRGB codes must show if they were taken as linear that is there, and its standard error."""

    share: float
    error: float

    @property
    def encoding(self) -> str | None:
        """ "srgb", "linear", or None where the samples do not tell."""
        if not np.isfinite(self.share) or self.error * SIGMAS > abs(self.share - 0.5):
            return None
        if abs(self.share - round(min(1.0, max(0.0, self.share)))) > FARTHEST:
            return None
        return "srgb" if self.share > 0.5 else "linear"


def find_encoding(codes: NDArray[np.float32], design: NDArray[np.float64]) -> EncodingFinding | None:
    """What codes [n angles, P places] in 0..1 tell, n > 3, with the polarisers' design [n, 3]; None where too few are usable.

    Places should be in image order (neighbours near each other).
    """
    n = len(design)
    if n < 4:
        return None
    usable = (codes.max(0) < CLIPPED) & (codes.min(0) > 0)
    v = codes[:, usable].astype(np.float64)
    if v.shape[1] < PARTS:
        return None
    solver = np.linalg.pinv(design)
    misfit = np.eye(n) - design @ solver
    shares = []
    # Taken as sRGB: the Stokes vectors in decoded light, and the misfit that their codes show when taken as linear.
    clean = srgb_encode(np.clip(design @ (solver @ srgb_decode(v)), 0, 1)).astype(np.float64)
    shares.append(_share(misfit @ v, misfit @ clean))
    # Taken as linear: the Stokes vectors of the codes, and the misfit that they show when decoded. Its share is the opposite.
    clean = srgb_decode(np.clip(design @ (solver @ v), 0, 1)).astype(np.float64)
    linear, error = _share(misfit @ srgb_decode(v), misfit @ clean)
    shares.append((1 - linear, error))
    (a, error_a), (b, error_b) = shares
    if not np.isfinite([a, b, error_a, error_b]).all():
        return None
    return EncodingFinding((a + b) / 2, max(error_a, error_b, abs(a - b) / 2 / SIGMAS))


def _share(found: NDArray[np.float64], predicted: NDArray[np.float64]) -> tuple[float, float]:
    """The factor of `predicted` [n, P] in `found` by least squares, and its standard error from regions' scatter."""
    top, bottom = (x.sum(0) for x in (found * predicted, predicted * predicted))
    edges = np.linspace(0, len(top), PARTS + 1).astype(int)[:-1]
    tops, bottoms = np.add.reduceat(top, edges), np.add.reduceat(bottom, edges)
    if not bottoms.sum() ** 2 > FEWEST_PARTS * (bottoms**2).sum():
        return np.nan, np.inf  # a single edge would decide, and agree with itself
    share = tops.sum() / bottoms.sum()
    return float(share), float(np.sqrt(((tops - share * bottoms) ** 2).sum()) / bottoms.sum())


def stack_codes(images: list[NDArray[np.float32]]) -> NDArray[np.float32]:
    """Codes [n angles, places x colours] of pictures [H, W, C], one an angle, averaged over neighbours in large ones."""
    height, width = images[0].shape[:2]
    bin_ = min(8, max(1, min(height, width) // FINE))
    rows, columns = height // bin_, width // bin_
    parts = []
    for image in images:
        colour = image[: rows * bin_, : columns * bin_]
        mean = colour.reshape(rows, bin_, columns, bin_, -1).mean((1, 3))
        clipped = (colour >= CLIPPED).reshape(rows, bin_, columns, bin_, -1).any((1, 3))
        parts.append(np.where(clipped, 1, mean).reshape(-1))
    return np.stack(parts).astype(np.float32)


FINE = 128
"""Places on a picture's shorter side that are enough; larger ones are averaged, which lowers noise."""
TILE, FLAT = 2, 0.1
"""Blocks a side of a mosaic's places, and how much their codes may vary: at edges the four angles see different things."""


def mosaic_codes(samples: NDArray[np.float32], bayer: bool) -> NDArray[np.float32]:
    """Codes [4 places of a 2x2 block row by row, flat tiles] of a mosaic [H, W]; quad-Bayer: each colour by itself."""
    step = 4 if bayer else 2
    height, width = (n // (step * TILE) * (step * TILE) for n in samples.shape)
    out = []
    for j, i in [(0, 0), (0, 2), (2, 0), (2, 2)] if bayer else [(0, 0)]:
        planes = np.stack([samples[j + a : height : step, i + b : width : step] for a in (0, 1) for b in (0, 1)])
        tiles = planes.reshape(4, height // step // TILE, TILE, width // step // TILE, TILE).swapaxes(2, 3)
        tiles = tiles.reshape(4, -1, TILE * TILE)
        mean = tiles.mean(-1)
        flat = tiles.std(-1).max(0) < FLAT * np.maximum(mean.mean(0), 1e-9)
        mean[:, tiles.max((0, 2)) >= CLIPPED] = 1
        out.append(mean[:, flat])
    return np.concatenate(out, 1)


def impossible_share(codes: NDArray[np.float32], design: NDArray[np.float64]) -> float:
    """Share of lit places of linear light [n, P] that are more than wholly polarised, beyond what their noise explains."""
    s0, s1, s2 = np.linalg.pinv(design) @ codes.astype(np.float64)
    lit = (s0 > 0.05 * np.percentile(s0, 99)) & (codes.max(0) < CLIPPED)
    return float((np.hypot(s1, s2)[lit] > 1.05 * s0[lit]).mean()) if lit.sum() >= PARTS else 0.0
