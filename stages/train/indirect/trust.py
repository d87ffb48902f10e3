"""How much a pixel's colour is believed while the light that the object sends to itself is known only roughly."""

from __future__ import annotations

from dataclasses import replace

from pipeline.shading import Occlusion

from ..views.view import View
from .pixel_light import PixelLight

DISTRUST = 2.0  # power of the unblocked share of a pixel's reflection as its weight at the start, as in the search for
# concavities; it falls to 0 at the end, when the shape that light was traced on is nearly the last one


def trusted(view: View, occlusion: Occlusion | None, done: float) -> View:
    """The view with less weight on the colours of pixels that mirror the object itself.

    What is traced follows the shape so far: a crease that is not there yet mirrors the sky, and its normals would turn to
    where the sky explains it. Until the shape is there, outlines and neighbours tell more.

    Args:
        view: what is compared; its `colour_weight` changes.
        occlusion: as traced for its counting pixels; what follows the rendering (`PixelLight`) leaves the view as it is.
        done: share of the run, 0..1.
    """
    if occlusion is None or isinstance(occlusion, PixelLight):
        return view
    return replace(view, colour_weight=view.colour_weight * occlusion.unblocked ** (DISTRUST * (1 - done)))
