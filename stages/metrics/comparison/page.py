"""compare.html: figures, costs and parameters that differ, and the same pictures of every result."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.formats import dataset_files as files
from pipeline.formats.gbuffer import surface_of
from pipeline.formats.images import RGB, S0, channel_names, read_exr, read_image, read_stokes
from pipeline.geometry.lens import frames_folder
from pipeline.report import pictures
from pipeline.report.pictures import evenly_chosen, exposure_of, picture
from pipeline.report.render import render
from stages.metrics.comparison.results import Result, read_results
from stages.metrics.comparison.tables import as_text, cost_lines, figure_lines, parameter_lines

SHOWN = 4  # views
LONGEST_PX = 320
DIFFERENCE_FULL = 0.1  # of display, at the bright end: as in the report


def compare(paths: Sequence[Path], output: Path) -> Path:
    """Print what differs between results, and write the page that shows it.

    Args:
        paths: datasets.
        output: folder for compare.html; made when missing.

    Returns:
        The page.

    Raises:
        UserError: a path holds no results.
    """
    results = read_results(paths)
    names = [result.name for result in results]
    figures, costs, parameters = figure_lines(results), cost_lines(results), parameter_lines(results)
    print(as_text([*figures, *(line for line in costs if line.group == "all")], names))
    context: dict[str, Any] = {
        "names": names, "paths": [str(p) for p in paths], "figures": figures, "costs": costs, "parameters": parameters,
    }  # fmt: skip
    output.mkdir(parents=True, exist_ok=True)
    page = output / "compare.html"
    context["views"] = view_rows(results)
    page.write_text(render("compare.html.jinja", context, Path(__file__).parent), encoding="utf-8")
    return page


def view_rows(results: Sequence[Result]) -> list[dict[str, Any]]:
    """Test views that every trained result has: the photograph, and of each the model, its difference and its normals."""
    trained = [r for r in results if "train" in r.folders]
    if not trained:
        return []
    shared = [set(files.held_back_views(r.folders["train"])) for r in trained]
    views = sorted(set.intersection(*shared))
    return [_row(view, trained) for view in evenly_chosen(views, SHOWN)]


def _row(view: str, results: Sequence[Result]) -> dict[str, Any]:
    measured = _photograph(view, results[0])
    gain = exposure_of(measured)
    first = picture(pictures.radiance(measured, gain), "photograph", results[0].name, LONGEST_PX, "")
    columns = []
    for result in results:
        path = files.held_back_image(result.folders["train"], view)
        model, surface = read_stokes(path)[:, :, 0], surface_of(read_exr(path))
        cells = [picture(pictures.radiance(model, gain), "model", result.name, LONGEST_PX, "")]
        if model.shape == measured.shape:
            inside = surface.alpha[..., None] > 0.02
            off = pictures.scale((np.abs(model - measured) * inside).mean(-1) * gain, 0, DIFFERENCE_FULL)
            cells.append(picture(off, "difference", "|s0| in the object", LONGEST_PX, ""))
        cells.append(picture(pictures.normals(surface.normal), "normals", result.name, LONGEST_PX, ""))
        columns.append(cells)
    return {"view": view, "photograph": first, "columns": columns}


def _photograph(view: str, result: Result) -> np.ndarray:
    path = files.frame(frames_folder(result.folders), view)
    return read_image(path, S0 if "S0.R" in channel_names(path) else RGB)
