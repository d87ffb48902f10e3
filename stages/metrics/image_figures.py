"""Figures of merit of images and normal maps. Radiance is linear RGB; PSNR and SSIM see it sRGB-encoded, clipped to [0, 1]."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pipeline.formats.images import srgb_encode
from pipeline.optics.stokes import angle, degree

Image = NDArray[np.float32]
Mask = NDArray[np.bool_]
PSNR_CEILING_DB = 120.0  # of equal images
SSIM_SIGMA, SSIM_RADIUS = 1.5, 5  # Wang et al. 2004: an 11-pixel Gaussian window
BLACK = 1e-4  # s0 below which noise would be wholly polarised
DARK = 0.01  # luminance below which DoLP is noise over nothing
FIRST_STEP = 1 / 255 / 12.92  # linear radiance of the first of a display's 255 levels
SEEN = 0.01  # share of samples between the first level and the last, below which a figure of display values is of nothing
POLARISED = 0.05  # DoLP below which an angle means nothing


def psnr(a: Image, b: Image, mask: Mask | None = None) -> float:
    """PSNR (dB) of display values in [0, 1], over the mask where one is given."""
    squared = (a.astype(np.float64) - b) ** 2
    error = float((squared if mask is None else squared[mask]).mean())
    return PSNR_CEILING_DB if error < 10 ** (-PSNR_CEILING_DB / 10) else -10 * np.log10(error)


def ssim_map(a: Image, b: Image) -> NDArray[np.float64]:
    """Structural similarity [H, W, C] of display values in [0, 1] (Wang et al. 2004), reflected at the border."""
    from skimage.metrics import structural_similarity

    height, width = a.shape[:2]
    rim = SSIM_RADIUS if min(height, width) <= 2 * SSIM_RADIUS else 0  # skimage refuses frames smaller than its window
    x, y = (np.pad(z.astype(np.float64), ((rim, rim), (rim, rim), (0, 0)), mode="symmetric") for z in (a, b))
    _, found = structural_similarity(
        x, y, data_range=1.0, channel_axis=-1, full=True, gaussian_weights=True, sigma=SSIM_SIGMA, use_sample_covariance=False
    )
    return found[rim : rim + height, rim : rim + width]


def ssim(a: Image, b: Image) -> float:
    """Mean structural similarity of the frame."""
    return float(ssim_map(a, b).mean())


def angle_deg(a: NDArray, b: NDArray) -> NDArray[np.float64]:
    """Angle [...] in degrees between vectors [..., 3], 0 to 180: a flipped normal is 180 off."""
    a, b = a.astype(np.float64), b.astype(np.float64)
    cross = np.linalg.norm(np.cross(a, b), axis=-1)
    return np.degrees(np.arctan2(cross, (a * b).sum(-1)))


def normal_figures(normal: Image, truth: Image, mask: Mask) -> dict[str, float]:
    """Mean angle and cosine distance over the mask; a missing normal (0) counts as 90 degrees."""
    error = angle_deg(normal, truth)
    error = np.where(np.linalg.norm(normal, axis=-1) > 0, error, 90.0)[mask]
    return {"normal_mae_deg": float(error.mean()), "normal_cosine_distance": float((1 - np.cos(np.radians(error))).mean())}


def displayable(truth: NDArray) -> bool:
    """Whether PSNR and SSIM, which see [0, 1] in steps of a display, see anything of radiance [..., 3]."""
    return float(np.mean((truth > FIRST_STEP) & (truth < 1))) > SEEN


def radiance_figures(image: Image, truth: Image, mask: Mask) -> dict[str, float]:
    """PSNR over the frame and inside the mask, and SSIM, of linear images [H, W, 3]."""
    a, b = srgb_encode(image), srgb_encode(truth)
    return {"psnr_srgb": psnr(a, b), "psnr_foreground": psnr(a, b, mask), "ssim": ssim(a, b)}


def dolp_aolp(stokes: NDArray) -> tuple[NDArray, NDArray]:
    """Degree [0, 1..] and angle (radians, (-pi/2, pi/2]) of linear polarisation of the colour mean of [H, W, 3, 3]."""
    mean = stokes.mean(-1, dtype=np.float64)
    mean[..., 0] = np.maximum(mean[..., 0], BLACK)
    return degree(mean), angle(mean)


def polarisation_figures(stokes: NDArray, truth: NDArray, mask: Mask) -> dict[str, float]:
    """Mean errors of DoLP and AoLP (degrees, up to 90) where there is light, and for AoLP where it is polarised."""
    dolp, aolp = dolp_aolp(stokes)
    true_dolp, true_aolp = dolp_aolp(truth)
    lit = mask & (truth[:, :, 0].mean(-1) > DARK)
    out = {}
    if lit.any():
        out["dolp_mae"] = float(np.abs(dolp - true_dolp)[lit].mean())
    polarised = lit & (true_dolp > POLARISED)
    if polarised.any():
        difference = (aolp - true_aolp + np.pi / 2) % np.pi - np.pi / 2
        out["aolp_mae_deg"] = float(np.degrees(np.abs(difference))[polarised].mean())
    return out


def erode(mask: Mask, rounds: int) -> Mask:
    """The mask without its outermost pixels, `rounds` times (4-neighbours)."""
    for _ in range(rounds):
        mask = mask & np.roll(mask, 1, 0) & np.roll(mask, -1, 0) & np.roll(mask, 1, 1) & np.roll(mask, -1, 1)
    return mask
