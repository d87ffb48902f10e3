"""How well the samples tell a mixture of tangents: variances of its widths, albedo and normal by its own normal equations.

The weights of its directions are parameters too: what a wide round lobe and two crossed narrow ones have in common is free.
"""

from __future__ import annotations

from pipeline.kernels.compiling import kernel
from pipeline.kernels.scratch import folded, matrix, vector
from stages.olat.pixel_fit.mixed_tangents import LOG_MAX, SIZE, mixed_equations
from stages.olat.pixel_fit.normal_matrix import UNKNOWN, inverse_form


@kernel(error_model="numpy")
def mixed_deviation(lobe, frame, x, o, h, i, light, floor, weight, tie, n_d, spare):
    """How a mixture's fit ended; samples of unit variance.

    x [LENGTH]: the mixture; tie: strength of the tie to n_d; spare [SPARE N]: workspace; for the rest see `fit_mixed`. Returns
    (0; 0: its last weights are not those that it was fitted under, so that they say nothing of its end; the largest variance of
    the log widths and the log albedo, the albedo's, the widths' mean, all by the samples alone; the mean square angle by which
    noise turns the normal).
    """
    count = light.size
    rows, one = folded(spare, SIZE, count), folded(spare[SIZE * count :], 6, count)
    whole, slope = matrix(SIZE, SIZE), vector(SIZE)
    mixed_equations(lobe, frame, x, o, h, i, light, floor, weight, rows, one, tie, n_d, whole, slope)
    system, right, place, total, n = matrix(SIZE, SIZE), vector(SIZE), vector(SIZE), 0.0, 0
    for j in range(SIZE):
        if j < 4 or x[j - 1] > 0:  # weights that are held at 0 have no say
            place[n] = j
            n += 1
        total += x[j - 1] if j >= 4 else 0.0
    for j in range(n):
        for k in range(n):
            system[j, k] = whole[int(place[j]), int(place[k])]
    tilt = 0.0
    for which in range(2):
        for j in range(n):
            right[j] = 1.0 if j == which else 0.0
        tilt += inverse_form(system, right, n)
    held = tie * max(frame[2, 0] * n_d[0] + frame[2, 1] * n_d[1] + frame[2, 2] * n_d[2], 0.5) if tie > 0 else 0.0
    system[0, 0] -= held
    system[1, 1] -= held
    told = vector(3)
    for which in range(3):
        for j in range(n):
            right[j] = (1.0 if j == 2 + which else 0.0) if which < 2 else (1.0 / total if j >= 4 else 0.0)
        told[which] = inverse_form(system, right, n)
    if x[0] >= LOG_MAX:  # the widest that a mixture may be: not where the samples would have it
        told[0] = UNKNOWN
    return 0.0, 0.0, max(told[0], max(told[1], told[2])), told[2], 0.5 * (told[0] + told[1]), tilt
