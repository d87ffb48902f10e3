"""What a trained scene leaves: files, angles with their precision, and how much of the test views it does not explain."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from pipeline.formats import dataset_files as files
from pipeline.formats.gbuffer import write_gbuffer
from pipeline.formats.images import write_exr
from pipeline.geometry.cameras import world_offset
from pipeline.geometry.lens import frame_table
from pipeline.report.explained import FEWEST, doubts, explained

from . import file_writers
from .lit.write import LitSplats, cameras_around, write_lit
from .objective import compared
from .render_view import Rendered, inner_coverage, mean_normals
from .setup import Start
from .trainer import Trainer
from .views.source_views import SourceView
from .views.view import View, prepare

if TYPE_CHECKING:
    from pipeline.engine.stage import StageRun

OTHER_ANGLE_DEG = 10.0  # from a trusted angle: filters are set to a degree, and the model bends what it fits by a few


def finish_polarisers(trainer: Trainer, stage: StageRun) -> None:
    """Standard deviations at the end, and a warning where the capture cannot determine the Stokes vector."""
    bank = trainer.scene.bank
    assert bank is not None
    for name, fit in trainer.estimate_angles(0).items():
        k = bank.names.index(name)
        bank.std_deg[k] = 0.0 if bank.trusted[k] else float(np.degrees(fit.std))
        if bank.trusted[k]:
            given, found, std = (float(np.degrees(v)) for v in (bank.angles[k].detach(), fit.angle, fit.std))
            apart = abs((found - given + 90) % 180 - 90)
            if apart > max(OTHER_ANGLE_DEG, 4 * std):
                stage.warn(
                    f"polariser {name}: set to {given % 180:.0f} degrees, but the pictures fit {found:.0f} ± {std:.0f}: check "
                    "the angle and how it is counted (counter-clockwise from the image's x axis), or find it (trusted = false)"
                )
    reason = bank.undetermined()
    if reason:
        stage.warn(f"the capture does not determine the polarisation: {reason}; check [polarisers] in capture.toml")


def whole_view(trainer: Trainer, start: Start, source: SourceView) -> tuple[View, Rendered]:
    """A view with every pixel that the model covers, whatever the masks say, and its rendering."""
    blank = replace(source, mask=np.ones_like(source.mask), valid=np.ones_like(source.valid))
    view = prepare(blank, start.frame, True, str(trainer.scene.model["position"].device))
    return view, trainer.renderer.render_whole(view)


def say_what_is_unexplained(trainer: Trainer, start: Start, sources: list[SourceView], stage: StageRun) -> None:
    """Hold the model against the test views; a line with the figure and the view where it is of the wrong kind."""
    noise = {view: facts.get("noise") or 0.0 for view, facts in frame_table(stage.inputs).items()}
    found = {}
    for source in sources:
        if source.split != "test":
            continue
        view = prepare(source, start.frame, False, str(trainer.scene.model["position"].device))
        if len(view.pixels) < FEWEST:
            continue
        rendered = trainer.renderer.render_whole(view).stokes
        model, target = compared(trainer.mode, trainer.scene, rendered, view)
        arrays = None
        if trainer.mode == "stokes":
            arrays = rendered[:, 1:].cpu().numpy(), view.target[:, 1:].cpu().numpy()
        scale = start.frame.exposure * (2.0 if trainer.mode == "polarisers" else 1.0)
        found[source.name] = explained(model.cpu().numpy(), target.cpu().numpy(), arrays, scale * noise.get(source.name, 0.0))
    stage.note(
        "explained", {view: {k: None if v is None else round(v, 4) for k, v in vars(f).items()} for view, f in found.items()}
    )
    for line in doubts(found):
        stage.warn(line)


def say_lost_gradients(trainer: Trainer, stage: StageRun) -> None:
    """One line where gradients were not finite: the steps went on without them, which nothing else would show."""
    lost = {name: found.tolist() for name, found in trainer.adam.not_finite.items() if found[0] > 0}
    if lost:
        first, name = min((since, name) for name, (_, since) in lost.items())
        stage.note("gradients_not_finite", {name: count for name, (count, _) in lost.items()})
        stage.warn(
            f"{sum(count for count, _ in lost.values())} entries of the gradients were not finite and counted as 0, from step "
            f"{first} on ({name}): check the pictures for absurd values, and the cameras for one inside the object"
        )


def openings_share(trainer: Trainer) -> float:
    """Mean share of the object's pixels that look into an opening, over the training views."""
    return float(np.mean([view.openings for view in trainer.pyramids[0]]))


def write_lit_splats(
    lit: LitSplats, trainer: Trainer, start: Start, sources: list[SourceView], stage: StageRun, offset: np.ndarray
) -> None:
    """splats_lit.ply and .spz, from what `lit` has seen from the captured cameras and from cameras all around."""
    around = cameras_around([s for s in sources if s.split != "test"], start.frame, lit.pixel())
    with stage.progress.bar("lit splats", total=len(around), unit="views") as bar:
        for source in around:
            lit.keep(*whole_view(trainer, start, source))
            bar.advance()
    for warning in write_lit(stage.output, lit, offset):
        stage.warn(warning)


def write_results(trainer: Trainer, start: Start, sources: list[SourceView], stage: StageRun) -> None:
    """Everything that docs/dataset.md lists for this stage, except the log."""
    output, frame = stage.output, start.frame
    (output / files.TESTS).mkdir(parents=True, exist_ok=True)
    (output / files.GBUFFERS).mkdir(parents=True, exist_ok=True)
    openings = openings_share(trainer) > 0
    lit = LitSplats(trainer.renderer, frame)
    with stage.progress.bar("writing views", total=len(sources), unit="views") as bar:
        for source in sources:
            view, rendered = whole_view(trainer, start, source)
            channels = file_writers.view_channels(rendered, view, frame)
            write_gbuffer(files.gbuffer(output, source.name), channels)
            if rendered.gbuffer.extra.shape[-1]:
                file_writers.write_learnt_light(files.learnt_light(output, source.name), rendered, view, frame)
            if source.split == "test":
                splats, backend = trainer.scene.model.activated(), trainer.renderer.backend
                channels = file_writers.with_normals(channels, mean_normals(splats, view, backend, openings), view, frame)
                if openings:
                    channels = file_writers.with_inner_sides(channels, inner_coverage(splats, view, backend))
                write_exr(files.held_back_image(output, source.name), channels)
            else:
                lit.keep(view, rendered)
            bar.advance()
    offset = world_offset(stage.inputs["poses"] / files.CAMERAS)
    file_writers.write_gaussians(output / files.GAUSSIANS, trainer.scene.model, frame, offset)
    write_lit_splats(lit, trainer, start, sources, stage, offset)
    file_writers.write_environment(output / files.ENVIRONMENT, trainer.scene.environment.radiance(), frame)
    file_writers.write_polarisers(output / files.POLARISERS, trainer.scene.bank)
    facts = {
        "up": stage.capture.up,
        "fresnel": trainer.parameters.fresnel,
        "lobe": trainer.parameters.lobe,
        "mirror": trainer.parameters.mirror,
        "environment_resolution": trainer.parameters.environment_resolution,
        "occlusion": bool(trainer.scene.occlusion),
        "indirect": trainer.parameters.indirect if trainer.scene.occlusion else "none",
    }
    none = "switched off" if trainer.parameters.indirect == "none" else "the object hides next to nothing of itself"
    stage.note("indirect", {"run": facts["occlusion"], "reason": facts["indirect"] if facts["occlusion"] else none})
    file_writers.write_lighting(output / files.LIGHTING, frame, facts)
