"""Diffuse and specular samples from the crossed and the parallel ones."""

from __future__ import annotations

import math

from numba import njit

from pipeline.lights.numerics import FAST, ONE, ZERO


@njit(cache=True, fastmath=FAST, error_model="numpy")
def separate(cross, parallel, energy, settings, level, room):
    """I_d = 2 I_x and I_s = f (I_p - I_x) per unit of irradiance; marks samples that are not finite or clipped.

    cross, parallel [3, N]. Returns (samples that are bad, clipped, brightest diffuse, brightest specular).
    """
    kind = energy.dtype.type
    scale_d = kind(2.0 * math.pi / settings.irradiance)
    scale_s = kind(settings.specular_factor / (3.0 * settings.irradiance))
    third = kind(1.0 / 3.0)
    bad = clipped = 0
    top_d = top_s = ZERO * energy[0]
    for k in range(energy.size):
        r, g, b = cross[0, k], cross[1, k], cross[2, k]
        x, y, z = parallel[0, k], parallel[1, k], parallel[2, k]
        total = r + g + b + x + y + z
        fine = abs(total) < kind(1e30)  # false for NaN and Inf
        clip_x = max(r, g, b) >= level
        clip_p = max(x, y, z) >= level
        e = ONE / energy[k] if fine else ZERO
        if not fine:
            r = g = b = x = y = z = ZERO
            bad += 1
        if clip_x or clip_p:
            clipped += 1
        d = scale_d * e
        room.rgb[0, k], room.rgb[1, k], room.rgb[2, k] = d * r, d * g, d * b
        mean = d * (r + g + b) * third
        room.diffuse[k] = mean
        s = scale_s * e * (x + y + z - r - g - b)
        room.specular[k] = s
        room.ok[k] = ONE if fine and not clip_x else ZERO
        room.floor[k] = ONE if clip_p else ZERO
        top_d = max(top_d, mean if fine else ZERO)
        top_s = max(top_s, s)
    return bad, clipped, top_d, top_s
