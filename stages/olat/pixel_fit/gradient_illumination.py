"""Ma et al. 2007: normals from the first moments of the samples over the directions, a width from the second; no fit."""

from __future__ import annotations

import math

from pipeline.kernels.compiling import kernel
from pipeline.kernels.scratch import matrix, vector
from pipeline.rig.map_flags import TOO_FEW
from stages.olat.pixel_fit.lobe_fit import round_start
from stages.olat.pixel_fit.paper_forms import gradient_direction, total
from stages.olat.pixel_fit.result_layout import (
    ALBEDO_D,
    ALBEDO_S,
    FLAG,
    NORMAL,
    NORMAL_D,
    NORMAL_S,
    OCCLUSION_D,
    OCCLUSION_S,
    ROUGHNESS,
    SIGMA,
    VISIBILITY_D,
    VISIBILITY_S,
)
from stages.olat.pixel_fit.specular import LOBE_FRACTION, frame_about, half_vectors, widths


@kernel(error_model="numpy")
def gradient_maps(n, workspace, w, o, area, flag, out):
    """Normals, albedos and a round width of one pixel into `out`, from its separated samples in the workspace.

    Occlusion and visibility are 1: what is lost in shadow is in the albedos, as in the paper.

    n: how many lights were gathered before the camera. The width is the second moment of the half vectors about n_s, as second
    gradients give it (Ghosh et al. 2009): without one, what the specular albedo is the albedo of could not be rendered.
    """
    kind = area.dtype.type
    x, y, z, found = gradient_direction(workspace.diffuse, workspace.ok, w, area)
    n_d = (x, y, z) if found else (o[0], o[1], o[2])
    x, y, z, shines = gradient_direction(workspace.specular, workspace.ok, w, area)
    x, y, z = x + o[0], y + o[1], z + o[2]
    size = math.sqrt(x * x + y * y + z * z)
    lobe = shines and size > 1e-6
    n_s = (x / size, y / size, z / size) if lobe else n_d
    for k in range(3):
        out[NORMAL_D + k], out[NORMAL_S + k], out[NORMAL + k] = n_d[k], n_s[k], n_d[k]
        out[ALBEDO_D + k] = max(total(workspace.rgb[k], workspace.ok, area) / math.pi, 0.0)
    out[ALBEDO_S] = max(total(workspace.specular, workspace.ok, area), 0.0)
    for at in (OCCLUSION_D, OCCLUSION_S, VISIBILITY_D, VISIBILITY_S):
        out[at] = 1.0
    out[FLAG] = flag if found else TOO_FEW
    if not (lobe and n > 0):
        return
    light, use, cosine, areas = workspace.light[:n], workspace.seen[:n], workspace.cosine[:n], workspace.area[:n]
    half = (workspace.half[0, :n], workspace.half[1, :n], workspace.half[2, :n])
    half_vectors(workspace.incident[0, :n], workspace.incident[1, :n], workspace.incident[2, :n], kind(o[0]), kind(o[1]),
                 kind(o[2]), half[0], half[1], half[2], cosine)  # fmt: skip
    top = 0.0
    for k in range(n):
        top = max(top, light[k])
    frame, shape = matrix(3, 3), vector(3)
    frame_about(n_s[0], n_s[1], n_s[2], frame)
    round_start(light, use, LOBE_FRACTION * top, areas, half, cosine, frame, shape)
    large, small, _ = widths(shape)
    if math.isfinite(large) and math.isfinite(small):
        width = math.sqrt(large * small)
        out[SIGMA], out[SIGMA + 1], out[ROUGHNESS] = width, width, math.sqrt(width)
