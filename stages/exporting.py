"""Results copied to a folder of their own, in one format that other programs open."""

from __future__ import annotations

import json
import os
import shutil
import tempfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.capture.view_rules import held_back
from pipeline.engine.dataset import Dataset
from pipeline.errors import UserError
from pipeline.formats import dataset_files as files
from pipeline.formats.images import RGB, channel_names, read_image, srgb_encode, write_mask, write_png
from pipeline.formats.json_file import read_json
from pipeline.geometry.cameras import load_cameras
from pipeline.geometry.lens import FRAMES, frames_folder

WHITE = 0.995  # quantile of a capture's radiance that 8-bit pictures show as white


def export(dataset: Dataset, to: str, output: str) -> Path:
    """Copy a dataset's results to a folder, in one format; the folder appears whole or not at all.

    Args:
        dataset: with the stages that make it finished.
        to: the format, of `FORMATS`.
        output: the folder; "": DATASET-FORMAT beside the dataset.

    Returns:
        The folder.

    Raises:
        UserError: the stage that makes it has not run, or the folder exists.
    """
    folder = Path(output) if output else dataset.root.absolute().with_name(f"{dataset.root.absolute().name}-{to}")
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise UserError(folder, "exists already", "give another folder by --out, or remove it")
    folder.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix=f".{folder.name}-", dir=folder.parent) as name:
        made = Path(name) / "made"
        made.mkdir()
        _writer(to)(dataset, made)
        if folder.is_dir():
            folder.rmdir()
        os.replace(made, folder)
    return folder


def _writer(to: str) -> Callable[[Dataset, Path], None]:
    special = {"nerfstudio": _nerfstudio, "colmap": _colmap, "splat": _splats, "maps": _maps}
    return special.get(to) or (lambda dataset, folder: _asset(dataset, folder, to))


def _stage(dataset: Dataset, name: str) -> Path:
    """The folder of a stage's version in use."""
    version = dataset.current(name)
    if version is None:
        raise UserError(dataset.root, f"has no results of the {name} stage", f"`polarfield {name}` makes them")
    return version.folder


def _asset(dataset: Dataset, folder: Path, to: str) -> None:
    from pipeline.asset.asset import FORMATS

    source = _stage(dataset, "mesh") / files.ASSET
    if not source.is_dir():
        raise UserError(dataset.root, "its mesh has no textures", "`polarfield mesh --textures true` makes them")
    for name in (*FORMATS[to], "asset.json"):
        if (source / name).is_dir():
            shutil.copytree(source / name, folder / name)
        else:
            shutil.copyfile(source / name, folder / name)


def _splats(dataset: Dataset, folder: Path) -> None:
    from stages.export_splats import export_splats

    train, mesh = _stage(dataset, "train"), dataset.current("mesh")
    facts = None if mesh is None else mesh.folder / files.ASSET / "asset.json"
    unit_m = read_json(facts, "run the mesh stage again").get("unit_m") if facts is not None and facts.exists() else None
    export_splats(train, unit_m, folder)


def _maps(dataset: Dataset, folder: Path) -> None:
    from stages.export_maps import export_maps

    export_maps(_stage(dataset, "decode"), _stage(dataset, "olat"), folder)


def _nerfstudio(dataset: Dataset, folder: Path) -> None:
    """transforms.json with 8-bit pictures and masks, as `ns-train` takes them."""
    poses = _stage(dataset, "poses")
    table = read_json(poses / files.CAMERAS, "run the poses stage again")
    shown = _pictures(dataset, folder / "images")
    frames = [frame for frame in table["frames"] if frame["view"] in shown]
    masks = dataset.current("masks")
    masked = {} if masks is None else {v: path for v in shown if (path := files.mask(masks.folder, v)).exists()}
    entries = []
    for frame in frames:
        view = frame["view"]
        entry: dict[str, Any] = {**frame, "file_path": f"images/{view}.png"}
        if masked:
            entry["mask_path"] = f"masks/{view}.png"
            _mask(masked.get(view), folder / entry["mask_path"], (frame["h"], frame["w"]))
        entries.append(entry)
    splits = _splits(_stage(dataset, "decode") / FRAMES, [frame["view"] for frame in frames])
    (folder / "transforms.json").write_text(json.dumps({**table, **splits, "frames": entries}, indent=1) + "\n")


def _mask(source: Path | None, path: Path, size: tuple[int, int]) -> None:
    """A copy of a view's mask; all of the picture where it has none, since nerfstudio wants one of each frame or none."""
    path.parent.mkdir(exist_ok=True)
    if source is None:
        write_mask(path, np.ones(size, bool))
    else:
        shutil.copyfile(source, path)


def _splits(index: Path, views: Sequence[str]) -> dict[str, list[str]]:
    """nerfstudio's lists of pictures by split: it holds back what our training does; empty where nothing is held back."""
    table = read_json(index, "run the decode stage again")
    apart = held_back(sorted(table["views"]), table.get("parts"))
    test = [v for v in views if apart.get(v) == "test"]
    lists = {
        "train": [v for v in views if v not in apart],
        "val": [v for v in views if apart.get(v) == "validation"] or test,
        "test": test,
    }
    return {f"{split}_filenames": [f"images/{v}.png" for v in chosen] for split, chosen in lists.items()} if test else {}


def _colmap(dataset: Dataset, folder: Path) -> None:
    """sparse/0 (text) with 8-bit pictures in images/."""
    poses = _stage(dataset, "poses")
    shown = _without_spaces(folder / "images", _pictures(dataset, folder / "images"))
    model = folder / "sparse" / "0"
    model.mkdir(parents=True)
    for name in ("cameras.txt", "points3D.txt"):
        shutil.copyfile(poses / "sparse" / name, model / name)
    lines = (poses / "sparse" / "images.txt").read_text(encoding="utf-8").splitlines()
    (model / "images.txt").write_text("\n".join(_renamed(line, shown) for line in lines) + "\n", encoding="utf-8")


def _without_spaces(folder: Path, shown: Mapping[str, str]) -> dict[str, str]:
    """The pictures by VIEW after white space in names became "_" or more: COLMAP's text ends a name at a space."""
    out: dict[str, str] = {}
    for view, name in shown.items():
        plain, gap = name, "_"
        while plain in out.values() or (plain != name and plain in shown.values()) or len(plain.split()) > 1:
            plain, gap = gap.join(name.split()), gap + "_"
        if plain != name:
            os.replace(folder / name, folder / plain)
        out[view] = plain
    return out


def _renamed(line: str, shown: Mapping[str, str]) -> str:
    """A line of images.txt with the picture that is written here in place of the frame."""
    words = line.split(" ", 9)
    if line.startswith("#") or len(words) < 10:
        return line
    view = words[9].rsplit(".", 1)[0]
    return " ".join([*words[:9], shown.get(view, words[9])])


def _pictures(dataset: Dataset, folder: Path) -> dict[str, str]:
    """8-bit sRGB pictures of all frames, of one exposure; their names by VIEW. Raises UserError where there are none."""
    upstream = {name: _stage(dataset, name) for name in ("decode", "poses")}
    source = frames_folder(upstream)
    views = [v for v in sorted(load_cameras(upstream["poses"] / files.CAMERAS)) if files.frame(source, v).exists()]
    if not views:
        raise UserError(dataset.root, "holds no frames of its cameras", "a light stage has none to export: take its maps")
    white = max(float(np.quantile(_radiance(files.frame(source, v)), WHITE)) for v in views)
    for view in views:
        write_png(folder / f"{view}.png", srgb_encode(_radiance(files.frame(source, view)) / max(white, 1e-30)))
    return {view: f"{view}.png" for view in views}


def _radiance(path: Path) -> NDArray[np.float32]:
    return read_image(path, [f"S0.{c}" for c in RGB] if "S0.R" in channel_names(path) else RGB)
