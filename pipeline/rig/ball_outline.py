"""A ball found by itself in a picture: the circle that most of its edges agree on, and how well."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

Float = NDArray[np.float64]
SIDE = 512  # pixels to which the picture is reduced for the search
LEAST_RADIUS = 10.0  # pixels: a smaller ball's normals are off by degrees
PERFECT = 0.8  # of cv2's measure of a circle's perfectness, its own recommendation for the rough search
ANGLES = 360
WINDOWS = (0.12, 0.06, 0.03)  # of the radius, about which edges are looked for round by round
CONTRAST = 0.15  # of the usual edge's strength below which there is none
NEAR = 0.02  # of the radius, and at least a pixel: an edge farther off is of something else
MOST_RESIDUAL = 0.015  # of the radius, and at least three quarters of a pixel: an ellipse or a box is no ball
LEAST_COVERED = 0.6  # of the outline that must be seen
ALIKE = 0.9  # of the best one's score, at which another circle is as likely


@dataclass(frozen=True)
class Outline:
    """A ball's circle in a picture, in pixels whose centres lie at +0.5.

    Fields:
        x, y: centre.
        radius: px.
        residual: root mean square distance of the edge from the circle (px).
        covered: share of the circle where there is an edge.
    """

    x: float
    y: float
    radius: float
    residual: float
    covered: float

    def mask(self, shape: tuple[int, int], fine: int = 4) -> Float:
        """Coverage [H, W] by the disc."""
        at = [(np.arange(n * fine) + 0.5) / fine for n in shape]
        on = np.hypot(at[1][None] - self.x, at[0][:, None] - self.y) < self.radius
        return on.reshape(shape[0], fine, shape[1], fine).mean((1, 3))


def find_ball(picture: Float) -> Outline:
    """The ball in a picture.

    Args:
        picture: linear, all lights on or the mean of the frames. [H, W] or [H, W, 3]

    Returns:
        The circle that most of the edges agree on.

    Raises:
        ValueError: says why there is none, or which two are as likely.
    """
    grey = np.asarray(picture, float).reshape(*picture.shape[:2], -1).mean(-1)
    top = float(np.quantile(grey, 0.99))
    if not top > 0:
        raise ValueError("the picture is black")
    shown = np.sqrt(np.clip(grey / top, 0, 1))  # a highlight's edge counts no more than the outline's
    found = [fitted(shown, *circle) for circle in _candidates(shown)]
    sound = [o for o in found if o is not None and _fault(o) is None]
    if not sound:
        faults = [fault for o in found if o is not None and (fault := _fault(o))]
        raise ValueError(faults[0] if faults else "no circle stands out")
    best = max(sound, key=_score)
    for other in sound:
        apart = np.hypot(other.x - best.x, other.y - best.y) + abs(other.radius - best.radius)
        if apart > 0.1 * best.radius and _score(other) > ALIKE * _score(best):
            places = " and ".join(f"({o.x:.0f}, {o.y:.0f}) of radius {o.radius:.0f}" for o in (best, other))
            raise ValueError(f"two circles are as likely: {places}")
    return best


def _score(outline: Outline) -> float:
    return outline.covered * outline.radius  # edge that is explained


def _fault(outline: Outline) -> str | None:
    where = f"the likeliest circle, at ({outline.x:.0f}, {outline.y:.0f}) of radius {outline.radius:.0f} px,"
    if outline.radius < LEAST_RADIUS:
        return f"{where} is too small to tell directions"
    if outline.covered < LEAST_COVERED:
        return f"{where} has an edge over {100 * outline.covered:.0f} % of its outline"
    if outline.residual > max(MOST_RESIDUAL * outline.radius, 0.75):
        return f"{where} is off its edge by {outline.residual:.1f} px"
    return None


def _candidates(shown: Float) -> list[tuple[float, float, float]]:
    """Likely circles (x, y, radius) by gradient voting, in pixels of the picture."""
    import cv2

    factor = max(1.0, max(shown.shape) / SIDE)
    size = tuple(max(1, round(n / factor)) for n in shown.shape[::-1])
    small = cv2.resize((shown * 255).astype(np.uint8), size, interpolation=cv2.INTER_AREA)
    most = int(0.7 * max(size))
    scale = shown.shape[1] / size[0]
    out = []
    for edge in (200.0, 80.0):  # dim outlines only where no clear one is
        found = cv2.HoughCircles(
            cv2.GaussianBlur(small, (5, 5), 1.2), cv2.HOUGH_GRADIENT_ALT, 1.5, 4.0, param1=edge, param2=PERFECT,
            minRadius=max(4, int(LEAST_RADIUS / scale)), maxRadius=most,
        )  # fmt: skip
        if found is not None:
            out += [((x + 0.5) * scale, (y + 0.5) * scale, r * scale) for x, y, r in found.reshape(-1, 3)[:, :3][:12].tolist()]
        if out:
            break
    return out


def fitted(shown: Float, x: float, y: float, radius: float) -> Outline | None:
    """The circle near a rough one that the picture's edges along its radii lie on, to a fraction of a pixel."""
    smooth = ndimage.gaussian_filter(shown, 1.0)
    angle = (np.arange(ANGLES) + 0.5) * (2 * np.pi / ANGLES)
    along, down = np.cos(angle), np.sin(angle)
    residual, covered = np.inf, 0.0
    for window in WINDOWS:
        reach = max(window * radius, 2.5)
        steps = np.arange(-reach, reach + 0.25, 0.25)
        distance = radius + steps
        rows, columns = y + down[:, None] * distance - 0.5, x + along[:, None] * distance - 0.5
        values = ndimage.map_coordinates(smooth, [rows, columns], order=1, mode="nearest")
        edge = np.abs(np.gradient(values, 0.25, axis=1))
        inside = (rows > 0) & (columns > 0) & (rows < shown.shape[0] - 1) & (columns < shown.shape[1] - 1)
        edge = np.where(inside, edge, 0.0)
        at = edge.argmax(1)
        strength = edge[np.arange(ANGLES), at]
        seen = strength > CONTRAST * max(float(np.median(strength)), 1e-3)
        if seen.sum() < ANGLES // 8:
            return None
        place = distance[at]
        px, py = x + along * place, y + down * place
        weight = seen.astype(float)
        for _ in range(10):
            matrix = np.stack([2 * px, 2 * py, np.ones(ANGLES)], -1) * weight[:, None]
            a, b, c = np.linalg.lstsq(matrix, (px**2 + py**2) * weight, rcond=None)[0]
            fit = np.sqrt(max(c + a * a + b * b, 1e-6))
            miss = np.hypot(px - a, py - b) - fit
            weight = seen / (1 + (miss / max(NEAR * fit, 1.0)) ** 2) ** 2
        if not (0.5 * radius < fit < 2 * radius and np.hypot(a - x, b - y) < radius):
            return None
        x, y, radius = float(a), float(b), float(fit)
        close = seen & (np.abs(miss) < 3 * max(NEAR * radius, 1.0))
        covered = float((seen & (np.abs(miss) < max(NEAR * radius, 1.0))).mean())
        residual = float(np.sqrt(np.mean(miss[close] ** 2))) if close.any() else np.inf
    return Outline(x, y, radius, residual, covered)
