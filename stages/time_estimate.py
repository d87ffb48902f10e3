"""What each stage and each of its passes takes, before it runs: seconds of one core of the reference machine, and MiB added.

Rates are per pixel, view, light, step or splat, found with the pinned libraries on the machine that
`pipeline.engine.costs.probe` calls the reference (captures of 64 to 512 px, 16 to 40 views). What runs take on another machine,
or of captures unlike those, is remembered there and corrects later estimates: these figures are where estimates begin. A stage
that a capture has no use for is estimated as if it ran on as many pixels.
"""

from __future__ import annotations

from typing import Any

from pipeline.capture import Capture
from pipeline.capture.view_rules import TEST_EVERY
from pipeline.engine.costs import COMPILING, ITSELF, Cost
from pipeline.environments import DEFAULT
from stages.kept_kernels import compiling_s
from stages.object_share import object_share
from stages.triangle_estimate import likely_triangles

Costs = dict[str, Cost]
MEGA = 1e6
LIGHTS = 346  # of a light stage that a capture is not: LSX3's
SURFACE = 320.0  # s a megapixel of the object, for the surface on which the cameras of a light stage agree
LATE = 200  # steps of training before which nothing is traced or validated


def decode(capture: Capture, parameters: Any) -> Costs:
    """Estimate decode: every picture is read, solved and written once; a light stage's frames are only looked through.

    Args:
        capture: as recognised.
        parameters: of the stage.

    Returns:
        What the stage itself and each of its passes take, by name.
    """
    if capture.light_stage is not None:
        frames = sum(len(c.frames) for c in capture.light_stage.cameras.values())
        from stages.calib.decode.frame_samples import EVERY, LARGE

        looked_at = max(capture.pixels, default=0) / MEGA
        looked_at /= EVERY if looked_at * MEGA > LARGE else 1
        return {ITSELF: Cost(0.08 + (5e-4 + 0.02 * looked_at) * frames, 135.0 + 28 * looked_at), **_compiling("decode")}
    files = sum(len(view.paths) for view in capture.views)
    itself = 0.25 + 0.012 * files + 0.25 * _megapixels(capture) * files / max(1, len(capture.views))
    beside = decode(capture.olat, parameters)[ITSELF].cpu_s if capture.olat is not None else 0.0
    return {ITSELF: Cost(itself + beside, 195.0), **_compiling("decode")}


def poses(capture: Capture, parameters: Any) -> Costs:
    """Estimate poses: given cameras are a table; found ones are features and matches of pairs (past 150 views, neighbours).

    Args:
        capture: as recognised.
        parameters: of the stage.

    Returns:
        What the stage itself and each of its passes take, by name.
    """
    views = max(1, len(capture.pixels))
    pixels = min(_megapixels(capture), views * parameters.max_size**2 / MEGA)
    pairs = views * (views - 1) / 2 if views <= 150 else 20 * views
    found = 2.0 + 1.1 * pixels + 0.15 * pairs + 0.5 * views
    return {
        ITSELF: Cost(0.04, 80.0), "colmap": Cost(found, 300.0 + 60 * pixels / views), "triangulation": Cost(0.7 * found, 300.0),
        "undistortion": Cost(0.6 * _megapixels(capture), 0.0),
    }  # fmt: skip


def masks(capture: Capture, parameters: Any) -> Costs:
    """Estimate masks: given masks are read and compared with the visual hull; others are segmented by what all views agree on.

    Args:
        capture: as recognised.
        parameters: of the stage.

    Returns:
        What the stage itself and each of its passes take, by name.
    """
    pixels = _megapixels(capture)
    at_work = min(pixels, len(capture.pixels) * parameters.max_size**2 / MEGA)
    itself = 0.4 if capture.light_stage is not None else 1.2 + 0.35 * pixels
    return {ITSELF: Cost(itself, 100.0), "segmentation": Cost(2.0 + 6.5 * at_work, 130.0), **_compiling("masks")}


def olat(capture: Capture, parameters: Any, compiled: bool) -> Costs:
    """Estimate olat: fits of the object's pixels to the samples of every light, and the reading of all samples.

    Args:
        capture: as recognised.
        parameters: of the stage.
        compiled: whether the fits' machine code is kept.

    Returns:
        What the stage itself and each of its passes take, by name.
    """
    stage = capture.light_stage
    lights = len(stage.lights) if stage is not None else LIGHTS
    pixels, share = _megapixels(capture), object_share(capture)
    one = 1.1 + 0.75 * lights  # s a megapixel of the object, on one core
    fitted = pixels * share * one
    general = {"closed": 1.0, "gradient": 0.3}.get(parameters.solver, 30.0)
    return {
        ITSELF: Cost(0.25 + 0.02 * pixels * lights + fitted * general, 160.0),
        "second fit": Cost(1.0 + SURFACE * pixels * share + 0.02 * pixels * lights + 1.5 * fitted * general, 420.0),
        "overexposure": Cost(0.03 * fitted), "near light": Cost(0.15 * fitted, 12 * pixels * lights / 8),
        "jax": Cost(3.0 + 29 * fitted, 400.0), "pixels outside the masks": Cost(pixels * (1 - share) * one, 124 * pixels),
        **({} if compiled else {COMPILING: Cost(50.0, 350.0)}),
    }  # fmt: skip


def train(capture: Capture, parameters: Any) -> Costs:
    """Estimate train: steps by object pixels and splats, the start from the hull, a G-buffer of every view at the end.

    Args:
        capture: as recognised.
        parameters: of the stage.

    Returns:
        What the stage itself and each of its passes take, by name.
    """
    views = max(1, len(capture.pixels))
    pixels, share = _megapixels(capture), object_share(capture)
    seen = pixels / views * share  # megapixels of the object in a view
    splats = parameters.likely_splats(seen * MEGA)
    halved = parameters.coarse_fraction if parameters.begins_coarse(seen * MEGA) else 0.0
    steps = parameters.steps(capture.polarisation if parameters.polarisation == "auto" else parameters.polarisation)
    shaded = 3.0 * MIRRORS.get(parameters.mirror, 1.0) * seen * (1 - 0.75 * halved)  # half-size images are a quarter
    step = 0.016 + shaded
    unknown = sum(p.angle_deg is None or not p.trusted for p in capture.polarisers.values()) or 1
    starts = 4 ** min(unknown, 2)
    late = max(steps - LATE, 0)
    whole = 1.2 + 0.02 * views + 1.25e-4 * splats + 0.91 * steps * step + late * (0.005 + 9e-7 * splats)
    return {
        ITSELF: Cost(whole, 650.0 + 100 * pixels + 3e-3 * splats),
        "indirect": Cost(late * (0.008 + 0.4 * seen) + 1.0, 60.0),
        "concavities": Cost(4.0 if late else 0.0, 40.0),
        "polariser_angles": Cost(1.5 + 0.012 * (60 * starts + 80 * 5 + 100 * 2), 25.0 * starts),
        "polarisation_loss": Cost(0.09 * steps * step, 24 * pixels * share),
        "start_from_points": Cost(0.5, 5.0), "olat_priors": Cost(0.07 * steps * step, 10.0),
        "pixels outside the masks": Cost(steps * shaded / share * (1 - share), 100 * pixels * (1 - share)),
        **_compiling("train"),
    }  # fmt: skip


MIRRORS = {"split": 0.5, "lobe-4": 0.7, "lobe-12": 0.95, "lobe-48": 1.6, "tree-coarse": 2.5, "tree": 3.0, "tree-fine": 4.0}
"""Time of an object's pixel by `mirror`, beside the default's."""


def mesh(capture: Capture, parameters: Any) -> Costs:
    """Estimate mesh: depths of all views in voxels, the surface's triangles, its textures.

    Args:
        capture: as recognised.
        parameters: of the stage.

    Returns:
        What the stage itself and each of its passes take, by name.
    """
    views = max(1, len(capture.pixels))
    pixels, share = _megapixels(capture), object_share(capture)
    around = 4 * pixels / views * share  # megapixels of the object's whole surface
    itself = Cost(1.8 + 2.0 * pixels + 120 * around * min(1.0, 1 / parameters.voxel_px**2), 390.0 + 55 * pixels)
    if capture.light_stage is not None:
        triangles = likely_triangles(capture, parameters.voxel_px, parameters.max_voxels)
        itself = Cost(3.0 + 2.0 * pixels + 7e-5 * triangles, 510.0 + 6.5e-4 * triangles)
    return {
        ITSELF: itself,
        "textures": Cost(1.5 + 80 * around / parameters.texel_px**2, 200 * around),
        "poisson": Cost(2.5 * 4 ** (parameters.poisson_depth - 8) + 40 * around, 150.0),
    } | _compiling("mesh")


def relight(capture: Capture, parameters: Any) -> Costs:
    """Estimate relight: every view under every map.

    Args:
        capture: as recognised.
        parameters: of the stage.

    Returns:
        What the stage itself and each of its passes take, by name.
    """
    maps = (len(capture.environments) or len(DEFAULT)) + bool(parameters.lights)
    pixels, views = _megapixels(capture), len(capture.pixels)
    share = object_share(capture)
    if capture.light_stage is not None:
        frames = pixels * len(capture.light_stage.lights)
        return {ITSELF: Cost(0.5 + 0.2 * maps + 0.15 * frames + 1.0 * maps * pixels * share, 220.0), **_compiling("relight")}
    tree = parameters.mirror.startswith("tree")
    lit = pixels * share * maps
    return {
        ITSELF: Cost(
            2.5 + 0.06 * views + 1.2 * maps * parameters.cube / 128 + lit * (18 if tree else 5), 500.0 + 3.5 * parameters.cube
        ),
        "indirect": Cost(1.5 + 3 * lit, 80.0),
        "turntable": Cost(0.15 * maps * max(1, parameters.turntable), 20.0), **_compiling("relight"),
    }  # fmt: skip


def metrics(capture: Capture, parameters: Any) -> Costs:
    """Estimate metrics: figures of the test views, the truth's, and the report with its pictures and what one turns in it.

    Args:
        capture: as recognised.
        parameters: of the stage.

    Returns:
        What the stage itself and each of its passes take, by name.
    """
    pixels, views = _megapixels(capture), len(capture.pixels)
    if capture.light_stage is not None:
        return {ITSELF: Cost(2.2 + 3.0 * pixels, 95.0)}
    maps = len(capture.environments)
    solid = 1.5 if capture.truth.mesh.is_file() else 0.0
    return {ITSELF: Cost(5.0 + 1.2 * pixels * (1 + maps / TEST_EVERY) + 0.05 * views + solid, 150.0)}


def _compiling(stage: str) -> Costs:
    seconds = compiling_s(stage)
    return {COMPILING: Cost(seconds, 150.0)} if seconds else {}


def _megapixels(capture: Capture) -> float:
    return sum(capture.pixels) / MEGA
