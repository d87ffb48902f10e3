"""A page that shows what was understood of a capture before anything long runs."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.capture import Capture
from pipeline.capture.view_rules import held_back
from pipeline.engine.changes import WORDS, State, standing
from pipeline.engine.outlook import outlook, saving
from pipeline.engine.plan import Step, plan_as_json
from pipeline.errors import UserError
from pipeline.formats.given_mask import read_given
from pipeline.formats.image_output import write_fault
from pipeline.formats.images import RGB, read_image
from pipeline.geometry.axes import nearest_to_lines
from pipeline.geometry.cameras import Camera
from pipeline.geometry.world import Y_UP_FROM

from . import pictures
from .pictures import AOLP_FULL, DOLP_FULL, evenly_chosen, exposure_of, picture, polarisation
from .render import render

SHOWN = 6  # views whose pixels are looked at
LONGEST = 288  # px


def write_inspection(
    capture: Capture, steps: Sequence[Step], folder: Path, found: Mapping[str, State], disk: Sequence[tuple[str, float]]
) -> Path:
    """Write the page that shows what was understood of a capture.

    Args:
        capture: as recognised.
        steps: its plan.
        folder: where to write inspect.html; made when missing.
        found: how each step stands, by stage.
        disk: how much each stage will leave: name, MB.

    Returns:
        The page.

    Raises:
        UserError: it cannot be written.
    """
    shown, faults = _views(capture)
    plan = plan_as_json(list(steps))
    context = {
        "name": capture.root.name,
        "facts": _facts(capture),
        "plan": [{"name": n, "passes": d.get("passes", {}), **d, **_standing(found[n])} for n, d in plan.items()],
        "outlook": outlook(found),
        "views": shown,
        "scene": json.dumps(scene_of(capture)),
        "disk": disk,
        "disk_total": sum(mb for _, mb in disk),
        "warnings": [("capture", w) for w in capture.warnings] + faults,
        "environments": [_environment(p) for p in capture.environments],
        "polarisers": _polarisers(capture),
    }
    path = folder / "inspect.html"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        path.write_text(render("inspect.html.jinja", context), encoding="utf-8")
    except OSError as error:
        raise write_fault(path, error.strerror or str(error)) from error
    return path


def _standing(state: State) -> dict[str, Any]:
    word = "left out" if state.kind == "skip" else WORDS[state.kind]
    return {"state": standing(state), "word": word, "saved": {name: saving(left) for name, left in state.saved.items()}}


PASSES = {"polarisers": "cross and parallel frames, or one of the two", "none": "none"}


def _facts(capture: Capture) -> list[tuple[str, str]]:
    """What was recognised, as names and values."""
    words = {"stokes": "full linear Stokes vectors", "polarisers": "photographs behind polarisers", "none": "none"}
    polarised = PASSES[capture.polarisation] if capture.light_stage is not None else words[capture.polarisation]
    out = [("layout", capture.layout.replace("_", " ")), ("polarisation", polarised), ("up axis", capture.up)]
    if capture.light_stage is not None:
        stage = capture.light_stage
        out += [("lights", str(len(stage.lights))), ("cameras", ", ".join(sorted(stage.cameras)))]
        sizes = {f"{c.camera.width} × {c.camera.height} px" for c in stage.cameras.values()}
        out.append(("image size", ", ".join(sorted(sizes))))
        masks = sum(c.mask is not None for c in stage.cameras.values())
        out.append(("masks", f"{masks} of {len(stage.cameras)} cameras"))
    else:
        sizes = {f"{v.size[0]} × {v.size[1]} px" for v in capture.views if v.size}
        out += [("views", str(len(capture.views))), ("image size", ", ".join(sorted(sizes)) or "as the files say")]
        out.append(("physical cameras", ", ".join(capture.camera_names)))
        given = "a COLMAP model" if capture.colmap else "not given: COLMAP will find them"
        out.append(("poses", f"given for {len(capture.cameras)} views" if capture.cameras else given))
        if isinstance(capture.masks, dict):
            out.append(("masks", f"given for {len(capture.masks)} views"))
        else:
            out.append(("masks", "in the images' alpha" if capture.masks == "alpha" else "not given: the object is segmented"))
    out.append(("environment maps", ", ".join(p.stem for p in capture.environments) or "none"))
    return out + [("also", fact) for fact in capture.facts]


def _polarisers(capture: Capture) -> list[dict[str, str]]:
    rows = []
    for name, prior in sorted(capture.polarisers.items()):
        angle = "unknown" if prior.angle_deg is None else f"{prior.angle_deg:g}°"
        use = "as given" if prior.trusted else "a starting value, optimised" if prior.angle_deg is not None else "optimised"
        rows.append({"name": name, "angle": angle, "use": use})
    return rows


def _views(capture: Capture) -> tuple[list[dict[str, Any]], list[tuple[str, str]]]:
    """Cards of a few views, and what was found wrong while reading them."""
    cards: list[dict[str, Any]] = []
    faults: list[tuple[str, str]] = []
    if capture.light_stage is not None:
        for name, camera in sorted(capture.light_stage.cameras.items()):
            try:
                cards.append({"view": name, "pictures": _stage_pictures(camera)})
            except UserError as error:
                faults.append((name, str(error)))
        return cards, faults
    for name in evenly_chosen([v.view for v in capture.views], SHOWN):
        try:
            cards.append({"view": name, "pictures": _view_pictures(capture, name)})
        except UserError as error:
            faults.append((name, str(error)))
    if cards and all(len(card["pictures"]) == 1 for card in cards):  # side by side, each under its name
        pics = [{**card["pictures"][0], "title": card["view"]} for card in cards]
        cards = [{"view": f"{len(pics)} of {len(capture.views)} views", "pictures": pics}]
    return cards, faults


def _stage_pictures(camera: Any) -> list[dict[str, str]]:
    """A few frames, cross and parallel, and the mask."""
    picks = evenly_chosen([str(i) for i in range(len(camera.cross))], SHOWN)[1:5]
    frames = [
        (kind, i, read_image(paths[int(i)], RGB))
        for i in picks
        for kind, paths in (("cross", camera.cross), ("parallel", camera.parallel))
    ]
    gain = 1 / max(float(np.percentile(np.concatenate([f[2].ravel() for f in frames]), 99.5)), 1e-6)
    out = [picture(pictures.radiance(pixels, gain), f"light {i}", kind, LONGEST) for kind, i, pixels in frames]
    if camera.mask is not None:
        out.append(
            picture(
                pictures.scale(read_given(camera.mask).pixels, 0, 255, ((0, 0, 0), (255, 255, 255))), "mask", "given", LONGEST
            )
        )
    return out


def _view_pictures(capture: Capture, name: str) -> list[dict[str, str]]:
    """Radiance, mask, DoLP and AoLP of one view."""
    decoded = capture.view(name).read()
    image = np.nan_to_num(decoded.s0)
    out = [
        picture(
            pictures.radiance(image, exposure_of(image)),
            "radiance",
            "s0" if decoded.stokes is not None else "as taken",
            LONGEST,
        )
    ]
    mask: NDArray | None = decoded.alpha
    if isinstance(capture.masks, dict) and name in capture.masks:
        mask = read_given(capture.masks[name]).pixels / 255
    if mask is not None and mask.shape == image.shape[:2]:
        shade = pictures.radiance(image, exposure_of(image)).astype(float)
        tinted = np.where((mask > 0.5)[..., None], shade, 0.25 * shade + np.array([120, 30, 20]))
        out.append(picture(tinted.clip(0, 255).astype(np.uint8), "mask", "red: not the object", LONGEST))
    inside = np.ones(image.shape[:2]) if mask is None or mask.shape != image.shape[:2] else (mask > 0.5) * 1.0
    if decoded.stokes is not None:
        degree, angle = polarisation(np.nan_to_num(decoded.stokes))
        out.append(picture(pictures.scale(degree, 0, DOLP_FULL, mask=inside), "DoLP", f"0 to {DOLP_FULL}", LONGEST))
        out.append(
            picture(pictures.angles(angle, degree / AOLP_FULL * inside), "AoLP", "hue, dim where hardly polarised", LONGEST)
        )
    if decoded.saturated is not None and decoded.saturated.any():
        out.append(
            picture(
                pictures.scale(decoded.saturated * 1.0, 0, 1), "saturated", f"{100 * decoded.saturated.mean():.2f} %", LONGEST
            )
        )
    return out


def _environment(path: Path) -> dict[str, str]:
    try:
        return picture(pictures.radiance(read_image(path, RGB)), path.stem, "", 560)
    except UserError as error:
        return {"src": "", "title": path.stem, "text": str(error), "place": ""}


def scene_of(capture: Capture) -> dict[str, Any]:
    """Cameras (frustum corners) and lights in a y-up frame scaled to radius 1, for the 3D drawing."""
    turn = Y_UP_FROM[capture.up]
    cameras: dict[str, Camera] = dict(capture.cameras or {})
    lights = np.zeros((0, 3))
    if capture.light_stage is not None:
        cameras = {n: c.camera for n, c in capture.light_stage.cameras.items()}
        lights = capture.light_stage.lights.positions
    if not cameras:
        return {"cameras": [], "lights": []}
    centres = np.stack([c.centre for c in cameras.values()])
    axes = np.stack([c.world_to_camera[2, :3] for c in cameras.values()])
    middle = np.zeros(3) if len(lights) else nearest_to_lines(centres, axes)
    middle = centres.mean(0) if middle is None else middle
    everything = np.concatenate([centres, lights]) - middle
    radius = float(np.linalg.norm(everything, axis=1).max()) or 1.0
    tested, out = held_back(cameras, capture.parts), []
    for name in sorted(cameras):
        c = cameras[name]
        corners = np.array([(0, 0), (c.width, 0), (c.width, c.height), (0, c.height)], float)
        local = np.concatenate([(corners - (c.cx, c.cy)) / (c.fx, c.fy), np.ones((4, 1))], 1)
        local *= 0.16 / np.linalg.norm(local[0])
        points = (c.centre - middle) / radius + local @ c.world_to_camera[:3, :3]
        test = capture.light_stage is None and tested.get(name) == "test"
        out.append(
            {
                "name": name,
                "at": _round((c.centre - middle) / radius @ turn.T),
                "corners": _round(points @ turn.T),
                "test": test,
            }
        )
    return {"cameras": out, "lights": _round((lights - middle) / radius @ turn.T)}


def _round(values: NDArray) -> Any:
    return np.round(values, 4).tolist()
