"""Which form of lobe few samples tell: a fit of another form that is as good says what is not known of the albedo.

A highlight that falls between the lights shows them its flank alone. The far flank of a GGX lobe, however narrow, falls by the
fourth power of the distance, which the next ring of lights cannot tell from a Gaussian of their own spacing: its albedo is then
whatever lies under the peak that no light has shown.
"""

from __future__ import annotations

import math

from pipeline.kernels.compiling import kernel
from pipeline.kernels.numerics import copy1, copy2
from pipeline.kernels.scratch import matrix, vector
from pipeline.rig.lobe_names import GGX
from pipeline.rig.lobes import values
from stages.olat.pixel_fit.lobe_fit import ABSOLUTE, RELATIVE, in_use, linear_albedo
from stages.olat.pixel_fit.specular import optimise, reweight

FEW = 8.0  # lights that a lobe is seen by, twice a round one's parameters: of more the residual tells the form
NARROWER = 4.0  # times narrower than what was fitted does the other form begin: at its flank
ODDS = 2.0 * math.log(100.0)  # of one form against another, from which it is told


@kernel(error_model="numpy")
def doubt(settings, seen, frame, shape, rho, tie, o, n_d, half, incident, light, floor, use, g, top, noise, workspace):
    """Standard deviation of the log albedo where a GGX lobe fits as well: half of what the two differ by; else 0.

    The lobe (frame, shape, rho; values g [N]) was fitted to the samples; seen: effective number of lights that show it, from
    `FEW` on nothing is tried; for the rest see `lobe_fit.fit_lobe`.
    """
    if settings.lobe == GGX or seen >= FEW:
        return 0.0
    kind = light.dtype.type
    absolute = kind(ABSOLUTE * top + 3 * noise)
    other, weight = workspace.trial[0, : light.size], workspace.trial[1, : light.size]
    cost = reweight(g, kind(rho), light, use, absolute, RELATIVE, weight)
    frame2, shape2, rho2, equations = matrix(3, 3), vector(3), vector(1), matrix(6, 6)
    copy2(frame, frame2)
    copy1(shape, shape2)
    isotropic = shape[0] == shape[1] and shape[2] == 0.0
    for k in range(2):
        shape2[k] += math.log(NARROWER)
    shape2[2] *= NARROWER
    values(GGX, frame2, shape2, o, half, incident, other)
    rho2[0] = linear_albedo(other, light, use, floor)
    reweight(other, kind(rho2[0]), light, use, absolute, RELATIVE, weight)
    optimise(GGX, frame2, shape2, rho2, o, half, incident, light, floor, weight, isotropic, tie, n_d, settings.steps,
             settings.tolerance, equations)  # fmt: skip
    values(GGX, frame2, shape2, o, half, incident, other)
    cost2 = reweight(other, kind(rho2[0]), light, use, absolute, RELATIVE, weight)
    if not (cost > 0 and rho2[0] > 0) or in_use(use) * math.log(cost2 / cost) > ODDS:
        return 0.0
    return 0.5 * abs(math.log(rho2[0] / rho))
