"""Is the Stokes frame right? What the object's outline says of it.

At the outline the normal lies in the image, across the outline; a dielectric there polarises diffuse light along the
normal and mirrored light along the outline (physics of Fresnel). So four times the angle between AoLP and outline
normal is near 0 in the right frame, whatever the mix: near 180° with the angle's zero off by 45°, and without order
when s2 has the wrong sign (45° and 135° swapped), which the mirrored AoLP then mends. A frame turned by 90° swaps
diffuse and mirrored light and cannot be told from the outline alone.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from pipeline.optics.stokes import angle, degree

RING = (1.5, 6.0)
"""Pixels inside the outline: past the mixed edge, before the normal turns to the viewer."""
MIN_PIXELS = 400
CLEAR, RATIO = 0.25, 2.0
"""Mean resultant length of the better frame, and its lead over the other, before anything is said."""
TURNED_DEG = 15
"""Of the angle's zero, from which it is said: normals at outlines are not exact."""


@dataclass(frozen=True)
class FrameEvidence:
    """Mean of exp(4i (AoLP - normal)) over the ring, weighted by polarised light, for s2 as it is and with its sign changed."""

    as_is: complex
    flipped: complex
    pixels: int


def contour_evidence(stokes: list[NDArray[np.float32]], masks: list[NDArray[np.bool_]]) -> FrameEvidence:
    """Evidence over views: Stokes [H, W, 3 (s0 s1 s2)] and masks [H, W]."""
    sums, weight, pixels = [0j, 0j], 0.0, 0
    for image, mask in zip(stokes, masks):
        padded = np.pad(mask, 1).astype(np.uint8)
        distance = cv2.distanceTransform(padded, cv2.DIST_L2, 5)[1:-1, 1:-1]
        smooth = cv2.GaussianBlur(distance, (0, 0), 1.5)
        down, right = np.gradient(smooth)
        ring = (distance > RING[0]) & (distance < RING[1])
        normal = np.arctan2(down[ring], -right[ring])  # outward, y up: the distance grows inwards and rows go down
        rim = image[ring].astype(np.float64)  # bad pixels of 1e30 and more are in some files
        rim[~np.isfinite(rim).all(-1)] = 0
        relative, twice = np.minimum(degree(rim), 1), np.exp(2j * angle(rim))
        for k, turn in enumerate((twice, np.conj(twice))):
            sums[k] += complex((relative * turn**2 * np.exp(-4j * normal)).sum())
        weight += float(relative.sum())
        pixels += int(ring.sum())
    weight = max(weight, 1e-12)
    return FrameEvidence(sums[0] / weight, sums[1] / weight, pixels)


def verdict(evidence: FrameEvidence) -> str | None:
    """A line for the user, or None where the outline says nothing or nothing is wrong."""
    as_is, flipped = abs(evidence.as_is), abs(evidence.flipped)
    if evidence.pixels < MIN_PIXELS or max(as_is, flipped) < CLEAR:
        return None
    if flipped > RATIO * as_is:
        turn = np.degrees(np.angle(evidence.flipped)) / 4
        also = f" and rotate_deg = {-turn:.0f} (or 90 more)" if abs(turn) > TURNED_DEG else ""
        causes = "s1 and s2 exchanged, or another zero of the angle besides" if also else "angles counted clockwise"
        return f"the sign of s2 looks wrong (45° and 135° swapped, or {causes}): try [stokes] flip_s2 = true{also}"
    turn = np.degrees(np.angle(evidence.as_is)) / 4
    if as_is > RATIO * flipped and abs(turn) > TURNED_DEG:
        return f"the angle's zero looks off by {turn:+.0f}° (or by 90° more): try [stokes] rotate_deg = {-turn:.0f}"
    return None
