"""Light directions and intensities from a ball in view: a mirror one by its highlight, a matte one by its shading.

The ball's outline tells its centre and radius, so the normal at every pixel; the camera's focal length, where it is known,
makes the sphere perspective (without one it is seen from far away). A mirror ball scatters a distant light alike in all
directions, so the sum of its highlight over the image is the light's intensity; a matte ball is linear least squares.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

Float = NDArray[np.float64]
HIGHLIGHT = 0.5  # of the brightest pixel: above it is the highlight's core, whose centre is the light's
FAINT = 3.0  # standard deviations above the ball's median at which a highlight stands out
LIT = 0.15  # of the brightest sample: below it a matte pixel is in shadow or too grazing to tell
ROUNDS = 12
SPILL = 2  # pixels about the core that share its light: a small highlight is spread over those next to it
RIM = 0.97  # of the radius: beyond it a pixel is partly background
NOISE = 1.4826  # standard deviation over median absolute deviation


@dataclass(frozen=True)
class BallLights:
    """The lights of N frames, as a ball in view shows them.

    Fields:
        directions: to the light, unit, camera frame (x right, y up, z to the camera). [N, 3]
        colours: irradiance relative to the mean of the lights that are seen. [N, 3]
        residual_deg: standard deviation of a direction by the frame's own misfit. [N]
        seen: whether the frame shows the light. [N]
    """

    directions: Float
    colours: Float
    residual_deg: Float
    seen: NDArray[np.bool_]


def outline_circle(mask: NDArray) -> tuple[float, float, float]:
    """Centre (x, y) and radius in pixels of a ball's mask [H, W] (coverage 0..1), by its area and centre of mass."""
    mask = np.asarray(mask, float)
    area = mask.sum()
    if not area > 0:
        raise ValueError("the ball's mask is empty")
    rows, columns = np.indices(mask.shape)
    return (
        float((mask * (columns + 0.5)).sum() / area), float((mask * (rows + 0.5)).sum() / area), float(np.sqrt(area / np.pi))
    )  # fmt: skip


def ball_normals(
    shape: tuple[int, int], circle: tuple[float, float, float], focal: float | None, principal: tuple[float, float] | None
) -> tuple[Float, Float, NDArray[np.bool_]]:
    """Normals and directions to the camera [H, W, 3] (camera frame: x right, y up, z back), and where the ball is [H, W].

    focal, principal point (pixels): None for a camera far away.
    """
    x0, y0, radius = circle
    rows, columns = np.indices(shape)
    x, y = columns + 0.5, rows + 0.5
    if focal is None or principal is None:
        u, v = (x - x0) / radius, -(y - y0) / radius
        square = u * u + v * v
        on = square < RIM**2
        normal = np.stack([u, v, np.sqrt(np.maximum(1 - square, 0))], -1)
        return normal, np.broadcast_to([0.0, 0, 1], normal.shape), on
    ray = np.stack([(x - principal[0]) / focal, -(y - principal[1]) / focal, -np.ones(shape)], -1)
    ray /= np.linalg.norm(ray, axis=-1, keepdims=True)
    towards = np.array([(x0 - principal[0]) / focal, -(y0 - principal[1]) / focal, -1.0])
    stretch = np.linalg.norm(towards)
    towards /= stretch
    sine = np.sin(np.arctan(radius / (focal * stretch)))  # of the angle under which the ball's radius is seen
    centre = towards / sine  # the ball's radius is 1
    along = ray @ centre
    root = along**2 - (centre @ centre - 1)
    on = root > (1 - RIM**2)
    point = ray * (along - np.sqrt(np.maximum(root, 0)))[..., None]
    return point - centre, -ray, on


def mirror_light(frame: Float, normal: Float, view: Float, on: NDArray[np.bool_]) -> tuple[Float, Float, float, bool]:
    """(direction [3], colour [3], standard deviation in degrees, seen) of the light in a mirror ball's frame [H, W, 3]."""
    grey = np.where(on, frame.mean(-1), 0.0)
    level = float(np.median(grey[on]))
    noise = NOISE * float(np.median(np.abs(grey[on] - level))) + 1e-12
    top = float(grey.max())
    if not top > level + FAINT * max(noise, 1e-3 * top):
        return np.array([0.0, 0, 1]), np.zeros(3), 180.0, False
    core = grey - level > HIGHLIGHT * (top - level)
    around = on & ndimage.binary_dilation(core, iterations=SPILL)
    weight = np.where(around, np.maximum(grey - level - noise, 0.0), 0.0)
    n = (weight[..., None] * normal).sum((0, 1))
    n /= np.linalg.norm(n)
    o = (weight[..., None] * view).sum((0, 1))
    o /= np.linalg.norm(o)
    direction = 2 * (n @ o) * n - o
    spread = np.sqrt((weight * ((normal - n) ** 2).sum(-1)).sum() / weight.sum())
    bright = on & (grey > level + FAINT * noise)
    colour = np.maximum((frame - np.median(frame[on], axis=0))[bright].sum(0), 0.0)
    pixels = max(int(core.sum()), 1)
    return direction, colour, float(np.degrees(2 * spread / np.sqrt(pixels))), True


def matte_light(frame: Float, normal: Float, on: NDArray[np.bool_]) -> tuple[Float, Float, float, bool]:
    """The same of a matte ball's frame: least squares of its shading over the pixels that the light reaches."""
    n, samples = normal[on], frame[on]
    grey = samples.mean(-1)
    top = float(np.quantile(grey, 0.98))
    if not top > 0:
        return np.array([0.0, 0, 1]), np.zeros(3), 180.0, False
    weight = (grey > 0.5 * top).astype(float)
    scaled, scale = np.zeros(3), top
    for _ in range(ROUNDS):
        equations = (n * weight[:, None]).T @ n
        if np.linalg.matrix_rank(equations, tol=1e-6 * np.trace(equations)) < 3:
            return np.array([0.0, 0, 1]), np.zeros(3), 180.0, False
        scaled = np.linalg.solve(equations, (n * weight[:, None]).T @ grey)
        predicted = n @ scaled
        lit = predicted > LIT * np.linalg.norm(scaled)
        miss = grey - predicted
        scale = max(NOISE * float(np.median(np.abs(miss[lit]))) if lit.any() else top, 1e-4 * top)
        weight = np.where(lit, 1.0 / (1.0 + (miss / (3 * scale)) ** 2) ** 2, 0.0)  # Geman and McClure: gloss and cast shadows
    length = float(np.linalg.norm(scaled))
    direction = scaled / length
    shade = np.maximum(n @ direction, 0.0)
    colour = (weight[:, None] * shade[:, None] * samples).sum(0) / (weight * shade**2).sum()
    covariance = scale**2 * np.linalg.inv((n * weight[:, None]).T @ n)
    across = np.trace(covariance) - direction @ covariance @ direction
    return direction, np.maximum(colour, 0.0), float(np.degrees(np.sqrt(max(across, 0.0)) / length)), True


def calibrated(frames: list[Float], mask: NDArray, kind: str, focal: float | None = None,
               principal: tuple[float, float] | None = None) -> BallLights:  # fmt: skip
    """Find the light of each frame from the ball in it.

    Args:
        frames: linear radiance. [H, W, 3] each
        mask: the ball, above 0.5. [H, W]
        kind: "mirror" or "matte".
        focal: focal length, pixels; None: the ball is seen from far away.
        principal: principal point x, y, pixels; it counts only together with `focal`.

    Returns:
        One light a frame.
    """
    normal, view, on = ball_normals(mask.shape, outline_circle(mask), focal, principal)
    on &= np.asarray(mask) > 0.5
    found = [mirror_light(f, normal, view, on) if kind == "mirror" else matte_light(f, normal, on) for f in frames]
    directions, colours, deviations, seen = (np.array(part) for part in zip(*found))
    mean = colours[seen].mean() if seen.any() else 1.0
    return BallLights(directions, colours / max(mean, 1e-30), deviations, seen.astype(bool))
