"""Whether an object hides anything from itself, by a few rays: where it does not, indirect light is left out."""

from __future__ import annotations

import numpy as np

from pipeline.geometry.occluder import Occluder, tangent_frames
from pipeline.optics.sphere import hemisphere_rule

LEAST_BLOCKED = 0.004
"""Mean share of diffuse light from which on an object occludes itself; below it counts as convex."""
RINGS, AZIMUTHS = 4, 16


def blocked_share(occluder: Occluder, samples: int = 500) -> float:
    """Estimate the share of cosine-weighted light that a mesh takes from itself.

    Args:
        occluder: the mesh.
        samples: how many of its vertices are asked, the same ones every time.

    Returns:
        0..1.
    """
    count = len(occluder.vertices)
    chosen = np.random.default_rng(0).choice(count, min(samples, count), replace=False)
    local, weight = hemisphere_rule(RINGS, AZIMUTHS)
    world = np.einsum("ka,pab->pkb", local, tangent_frames(occluder.normals[chosen]))
    origins = occluder.vertices[chosen] + occluder.lift * occluder.normals[chosen]
    blocked = occluder.cast(*(a.reshape(-1, 3) for a in np.broadcast_arrays(origins[:, None], world))).blocked
    return float((blocked.reshape(world.shape[:2]) * (weight * local[:, 2])).sum(-1).mean() / np.pi)
