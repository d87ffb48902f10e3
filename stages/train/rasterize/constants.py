"""Every number the rasteriser's definition rests on, each with its reason. All are free of scene units."""

ALPHA_MAX = 0.99
"""Opacity cap of one splat at one pixel: keeps 1 - alpha away from 0, so what lies behind still gets a gradient (3DGS)."""

ALPHA_MIN = 1.0 / 255.0
"""Contributions below one step of an 8-bit image are skipped (3DGS, gsplat)."""

TRANSMITTANCE_STOP = 1e-4
"""A splat that would bring the transmittance below this is not blended and ends the pixel (3DGS, gsplat); with layered
blending, the first splat of a further layer does, once the transmittance is below. With
ALPHA_MAX = 0.99, two opaque splats (0.01 squared) reach it."""

LEAST_TRANSMITTANCE = 1e-30
"""With layered blending, a splat that would bring the transmittance below this ends the pixel: float32 ends at 1e-38."""

MAX_LAYERS = 4
"""With layered blending, layers of a pixel that are kept apart; what lies behind the last but one is one layer."""

CUTOFF_SIGMA = 3.0
"""A splat ends at 3 sigma, per pixel, in its own plane: exp(-4.5) = 0.011 of its peak. gsplat and 2DGS cut whole tiles
at about 3 sigma instead, so there the result depends on the tile size by up to that 0.011."""

CUTOFF_RHO = CUTOFF_SIGMA**2

SCREEN_INVERSE_VARIANCE = 2.0
"""Low-pass filter of 2DGS and gsplat: rho = min(u^2 + v^2, 2 |x - c|^2), a screen-space Gaussian of sigma 0.71 px, so a
splat smaller than a pixel or seen edge-on is still sampled. Times the square of `screen_filter`. [1 / px^2]"""

NEAR_FRACTION = 0.01
"""Default near plane: this fraction of the median camera z of the splats in front of the camera (scale invariant)."""

MIN_COSINE = 1e-4
"""Below this |cosine| between normal and viewing ray (0.006 degrees from edge-on) float32 leaves fewer than three digits
of n.p, so the object-space kernel is dropped; the screen-space one, if on, remains."""

MIN_SIGMA_PX = 1e-4
"""A sigma that projects (face on) below this many pixels is floored to it: pixel centres meet so thin a kernel only by
accident, and (image width / sigma)^2 must stay finite in float32."""

MIN_RELATIVE_DEPTH_INVERSE = 1e-6
"""Floor of q = z_centre / z_hit before dividing: a hit a million times farther than its splat's centre is the horizon."""

MAX_HALF_ANGLE_FRACTION = 0.999
"""A disc whose cut-off circle comes this close to the camera plane (as a fraction of the centre's z) has no finite
projected outline: its bounding box is the whole image."""

BOUNDS_MARGIN_PX = 0.01
"""Bounding boxes are grown by this, above the rounding of their corners in float32, so a box never cuts its splat."""
