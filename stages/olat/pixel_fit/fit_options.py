"""Options of the per-pixel fit as plain numbers, and the sizes of its workspaces. Importing this loads nothing heavy."""

from __future__ import annotations

from typing import NamedTuple

CHUNK = 16  # pixels turned at a time: 96 contiguous bytes of a half-float frame, and their samples stay in the L2 cache
SPARE = 9 + 12 + 6 + 1
"""Scratch floats per light of the mixed-tangent fit: 9 of a light near the lobe, 12 derivatives, 6 of one lobe, 1 weight."""
ROWS = 3 + 14 + 3 + 3 + 2 + SPARE
"""Floats per light in a pixel's workspace."""
WORKSPACE_PER_LIGHT = 6 * CHUNK + 4 + ROWS
"""Floats per light in a thread's workspace: a chunk's samples, directions and energies of near lights, a pixel's workspace."""

JOINT, HALF_VECTOR, CORRELATION = 0, 1, 2
SPECULAR_FITS = {"joint": JOINT, "half-vector": HALF_VECTOR, "correlation": CORRELATION}
BOTH, CROSS_ALONE, PARALLEL_ALONE, UNPOLARISED = range(4)
PASSES = {"both": BOTH, "cross": CROSS_ALONE, "parallel": PARALLEL_ALONE, "none": UNPOLARISED}
"""How a capture's word for its passes is told to the kernels."""
ROUND = 0.03  # anisotropy below which a lobe counts as round


class FitOptions(NamedTuple):
    """What the kernels need to know about a capture and how to fit it."""

    lobe: int
    rounds: int  # reweighting rounds of the diffuse fit
    robust: int  # reweighting rounds of the specular fit (0: plain least squares)
    steps: int  # Levenberg-Marquardt steps at the end
    tolerance: float  # gradient norm, data of unit norm, at which a fit ends
    saturation: float  # radiance from which a sample is clipped (inf: none is)
    specular_factor: float
    irradiance: float
    gain: float  # share of the round lobe's robust cost that an anisotropic one must beat
    mixed: float  # by how much mixed tangents must lower one lobe's robust cost, `lobe_fit.CERTAIN` (0: never tried)
    prior: float  # strength of the tie of n_s to n_d: inverse square of the angle (rad) they may differ by
    plain: bool  # diffuse fit without robust weights (PRF Eq. 12)
    specular_fit: int  # how n_s is found, `SPECULAR_FITS`
    fuse_correlation: bool  # fuse the normals by correlation (PRF) instead of inverse variance
    printed_maps: bool  # occlusion and inter-reflection as PRF Eqs. 4 and 5 print them
    remove: bool  # clipped samples by PRF Algorithm 1 instead of as bounds
    gradient: bool  # gradient illumination alone (Ma et al. 2007)
    one_pass: int  # which passes there are, `PASSES`
    gap: float  # PRF Algorithm 1's epsilon: gap, of the brightest sample, above which samples are spikes
    removals: int  # PRF Algorithm 1's M: how often spikes are taken down
