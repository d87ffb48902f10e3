"""What each point sees of an environment's bright parts (numba, float32): `sharp_shadows` says what for."""

from __future__ import annotations

import numpy as np
from numba import prange

from pipeline.kernels.compiling import kernel

from .cube_kernels import MATH
from .facet_kernels import masking, reflectance
from .light_tree_lobe import lobe_weight
from .prefilter_kernels import REFERENCE_IOR
from .shade_kernels import surface_point

BELOW, VISIBLE, HIDDEN, DOUBTFUL = 0, 1, 2, 3
"""A leaf under a point's horizon; as the vertices around the point have it; and where they disagree."""
_ZERO, _QUARTER, _HALF, _ONE = (np.float32(x) for x in (0, 0.25, 0.5, 1))
_REFERENCE = np.float32(REFERENCE_IOR)
_LEAST = np.float32(0.01)  # `limits.MIN_COSINE`
_OVER_PI = np.float32(1 / np.pi)


@kernel(parallel=True, fastmath=MATH, error_model="numpy")
def classify(normal, corners, some, every, owner, direction, state):
    """Fill state [P, L] for points with corners [P, 3] among V vertices, of which some or all around see a texel [V, K']."""
    for p in prange(len(normal)):
        a, b, c = corners[p, 0], corners[p, 1], corners[p, 2]
        for k in range(len(owner)):
            cosine = normal[p, 0] * direction[k, 0] + normal[p, 1] * direction[k, 1] + normal[p, 2] * direction[k, 2]
            if cosine <= _ZERO:
                state[p, k] = BELOW
                continue
            t = owner[k]
            if every[a, t] and every[b, t] and every[c, t]:
                state[p, k] = VISIBLE
            elif some[a, t] or some[b, t] or some[c, t]:
                state[p, k] = DOUBTFUL
            else:
                state[p, k] = HIDDEN


@kernel(parallel=True, fastmath=MATH, error_model="numpy")
def sums(normal, view, roughness, ior, state, direction, solid_angle, variance, radiance, ggx, taken, whole, lost):
    """Fill what hidden leaves take of irradiance, `taken` [P, 3], and of leaves mirrored, all and hidden: [P].

    Irradiance is as prefiltered for diffuse light; mirrored light, its colours summed, lacks division by the lobe's albedo.
    """
    for p in prange(len(normal)):
        n, v, nv, r, e = surface_point(normal, view, roughness, ior, p)
        nv = min(max(nv, _LEAST), _ONE)
        a2 = r * r * r * r
        scale = _QUARTER * _OVER_PI * _HALF * masking(nv, a2, ggx) / nv
        t0, t1, t2, all_, off = _ZERO, _ZERO, _ZERO, _ZERO, _ZERO
        for k in range(len(direction)):
            if state[p, k] == BELOW:
                continue
            l = (direction[k, 0], direction[k, 1], direction[k, 2])
            w = lobe_weight(n, v, l, nv, a2, e, ggx, variance[k])[0] * scale * solid_angle[k]
            w *= radiance[k, 0] + radiance[k, 1] + radiance[k, 2]
            all_ += w
            if state[p, k] == HIDDEN:
                off += w
                cosine = n[0] * l[0] + n[1] * l[1] + n[2] * l[2]
                w = cosine * (_ONE - _HALF * reflectance(cosine, _REFERENCE)) * solid_angle[k]
                t0, t1, t2 = t0 + w * radiance[k, 0], t1 + w * radiance[k, 1], t2 + w * radiance[k, 2]
        taken[p, 0], taken[p, 1], taken[p, 2] = t0, t1, t2
        whole[p], lost[p] = all_, off
