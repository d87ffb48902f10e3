"""Train: 2D Gaussians with polarimetric deferred shading (PhyGaP), from decoded views, cameras and masks."""

from __future__ import annotations

from pipeline.capture import Capture
from pipeline.capture.view_rules import MIN_TRAINING_VIEWS
from pipeline.engine.stage import Decision, Stage, StageRun
from stages import memory_estimate, time_estimate

from .parameters import TrainParameters
from .use_of_maps import maps_in_training


def needed(capture: Capture, parameters: TrainParameters) -> Decision:
    """Several views of one object; passes that the data do not need are left out."""
    if capture.kind != "multiview":
        return Decision(False, "a light stage of fixed cameras: nothing to train on")
    if len(capture.views) < MIN_TRAINING_VIEWS:
        return Decision(False, f"only {len(capture.views)} views; training needs {MIN_TRAINING_VIEWS} around the object")
    mode = capture.polarisation if parameters.polarisation == "auto" else parameters.polarisation

    def known(name: str) -> str:
        prior = capture.polarisers.get(name)
        angle = None if prior is None else prior.angle_deg
        return f"{name} unknown" if angle is None else f"{name} refined from {angle:g} degrees"

    unknown = [n for n in capture.camera_names if mode == "polarisers" and not _trusted(capture, n)]
    polarised = {
        "stokes": Decision(True, "full Stokes images"),
        "polarisers": Decision(True, "compared behind each polariser"),
        "none": Decision(False, "RGB only"),
    }[mode]
    angles = Decision(bool(unknown), ", ".join(map(known, unknown)) if unknown else "no unknown polariser angle")
    off = parameters.indirect == "none"
    indirect = Decision(not off, "switched off" if off else f"{parameters.indirect}, if the trained shape hides any of itself")
    why = "switched on" if parameters.concavities == "on" else "full Stokes tells hollows from the hull"
    why_not = "switched off" if parameters.concavities == "off" else "only full Stokes is evidence enough"
    concavities = Decision(True, why) if parameters.searches_concavities(mode) else Decision(False, why_not)
    passes = {"polarisation_loss": polarised, "polariser_angles": angles, "indirect": indirect, "concavities": concavities}
    passes["olat_priors"] = maps_in_training(capture, parameters.olat_priors)
    passes["pixels outside the masks"] = Decision(False, "only pixels of the object are rendered")
    return Decision(True, f"{len(capture.views)} views of one object", passes)


def _trusted(capture: Capture, name: str) -> bool:
    prior = capture.polarisers.get(name)
    return prior is not None and prior.trusted and prior.angle_deg is not None


def run(stage: StageRun) -> None:
    """Train and write what docs/dataset.md lists for this stage."""
    from .run import train

    train(stage)


STAGE = Stage(
    name="train",
    version=17,
    parameters=TrainParameters,
    needs=("decode", "poses", "masks", "olat"),
    needed=needed,
    run=run,
    config=("up", "polarisers"),
    device=True,
    memory=memory_estimate.train,
    costs=time_estimate.train,
    parallel=0.3,
)
