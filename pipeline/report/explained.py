"""Does a model explain the pictures? Figures that tell a model that is wrong from one that is only rough, with their limits.

A rough model (few steps, few views) is blurred and somewhat too dark, but light and dark lie where they do in the picture. A
model of the wrong kind (a dielectric for metal or glass, distant light for a lamp in the scene) or with wrong cameras puts them
elsewhere. Radiance is compared as the eye would, encoded and up to a common gain.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

GAMMA = 1 / 2.4  # sRGB's exponent
DARK = 0.02  # of the mean radiance, added before encoding: noise in the dark is no contrast
FEWEST = 30  # pixels, below which a view tells nothing: a correlation of nothing then scatters by 1/sqrt(30), 0.18
LIKE = 0.5
"""Correlation of model and picture from which the model counts: 0.5 is a quarter of the variance. Sound captures have 0.75
after 60 steps, 0.8 to 0.97 when trained; metal, a mirror, glass and exchanged cameras 0.3 to 0.4."""
NEAR = 0.1  # mean difference below which a picture is explained whatever its correlation: what sound models end at, by OFF
OFF = 0.28
"""Mean difference over the mean, encoded, above which the model misses: a factor of 1.8 in radiance. Sound captures have 0.26
after 60 steps, 0.04 to 0.09 when trained; a scene under one lamp or a naked sun 0.3 to 0.4."""
SOUND = 0.75
"""Correlation from which OFF alone decides. Between LIKE and this the difference that is borne rises from NEAR to OFF: a glass
ball and metal end at 0.50 and 0.63 with a difference of 0.20 and 0.29, what 60 steps make of a sound capture at 0.75 with 0.26,
a surface that no view sees at 0.74 with 0.13. With limits for each alone a little better fit would silence both."""
CONTRAST = 2.0  # times the noise of a pixel's mean over its channels: less variation over a picture is noise as well
UNEXPLAINED = 1.0
"""Square error of s1 and s2 over their own square: above it no polarisation at all would explain them better. Trained models
have 0.2, half-trained ones 0.85; a mirrored or turned Stokes frame 1.1 to 1.2."""


@dataclass(frozen=True)
class Explained:
    """Figures of one view; None where noise or too few pixels forbid to tell.

    Fields:
        likeness: correlation of the encoded radiance.
        off: mean difference of the encoded radiance at the best gain, relative to its mean.
        polarisation: share of the polarised light that is not explained.
    """

    likeness: float | None
    off: float | None
    polarisation: float | None


def explained(
    model: NDArray, picture: NDArray, polarised: tuple[NDArray, NDArray] | None = None, noise: float = 0.0
) -> Explained:
    """Compute how well a model explains one view, over the object's pixels.

    Args:
        model: its radiance. [P, 3]
        picture: the photograph's radiance. [P, 3]
        polarised: s1, s2 of the model and of the photograph; None: not measured. [P, 2, 3] each
        noise: standard deviation of a sample of the picture, in its units; what it explains is not held against the model.

    Returns:
        The figures.
    """
    if len(picture) < FEWEST or not float(np.mean(picture)) > 0:
        return Explained(None, None, None)
    level = float(np.mean(picture))
    a, b = (np.maximum(np.asarray(x, float) / level, 0) + DARK for x in (model, picture))
    a, b = a**GAMMA, b**GAMMA
    gain = float((a * b).sum() / (a * a).sum())
    by_noise = GAMMA * noise / level
    off = float(np.abs(gain * a - b).mean() / b.mean())
    off = float(np.sqrt(max(off**2 - by_noise**2, 0.0)))
    x, y = a.mean(-1), b.mean(-1)
    likeness = None
    if y.std() > CONTRAST * by_noise * y.mean() / np.sqrt(3):
        likeness = float(np.corrcoef(x, y)[0, 1]) if x.std() > 0 else 0.0  # a model without contrast is like nothing
    return Explained(likeness, off, None if polarised is None else _unexplained(*polarised, noise))


def _unexplained(model: NDArray, picture: NDArray, noise: float) -> float | None:
    picture = np.asarray(picture, float)
    grain = picture.size * noise**2
    signal = float((picture**2).sum()) - grain
    if not signal > grain:
        return None  # as much noise as light
    return max(float(((model - picture) ** 2).sum()) - grain, 0.0) / signal


def doubts(views: Mapping[str, Explained]) -> list[str]:
    """Say what a model does not explain.

    Args:
        views: figures of views that it has not seen.

    Returns:
        Lines with the figure, the worst view and what to check; none where it explains them.
    """
    lines = []
    likeness, worst, value = _mean(views, "likeness", min)
    off, furthest, most = _mean(views, "off", max)
    if likeness is not None and off is not None and likeness < SOUND and off > _borne(likeness):
        lines.append(
            f"the model does not explain the pictures: it is like views that it has not seen by {likeness:.2f} (1 is alike, "
            f"sound captures have 0.75 and more), worst {worst} by {value:.2f}. Too few steps, metal, glass, a mirror, a lamp "
            "in the scene, or wrong cameras? Look at that view beside its rendering"
        )
    elif off is not None and off > OFF:
        factor = (1 + off) ** (1 / GAMMA)
        lines.append(
            f"the model misses the radiance of views that it has not seen by a factor of {factor:.1f}, most in {furthest} "
            f"({(1 + most) ** (1 / GAMMA):.1f}): too few steps, one lamp or a naked sun, metal, or light inside the scene? "
            "Look at that view beside its rendering"
        )
    polarisation, turned, share = _mean(views, "polarisation", max)
    if polarisation is not None and polarisation > UNEXPLAINED:
        lines.append(
            f"the model explains the polarisation worse than none at all would ({100 * polarisation:.0f} % of the polarised "
            f"light is left over, most in {turned}, {100 * share:.0f} %): check whether the Stokes frame is mirrored or turned "
            "([stokes] flip_s2, rotate_deg), or a polariser's angle wrong"
        )
    return lines


def _borne(likeness: float) -> float:
    """Mean difference up to which a model of a likeness below SOUND counts as rough."""
    return NEAR + (OFF - NEAR) * max(likeness - LIKE, 0.0) / (SOUND - LIKE)


def _mean(
    views: Mapping[str, Explained], name: str, worst: Callable[[Sequence[tuple[float, str]]], tuple[float, str]]
) -> tuple[float | None, str, float]:
    """(mean of a figure over the views that have it, the worst view, its figure)."""
    found: Sequence[tuple[float, str]] = [(v, view) for view, f in sorted(views.items()) if (v := getattr(f, name)) is not None]
    if not found:
        return None, "", 0.0
    value, view = worst(found)
    return float(np.mean([v for v, _ in found])), view, value
