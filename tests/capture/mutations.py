"""Ways in which a capture's files go wrong: cut, flipped, exchanged, of another type or shape, named with paths."""

from __future__ import annotations

import json
import os
import random
import re
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.formats.images import write_exr, write_png

ODD: tuple[Any, ...] = (
    *(None, True, False, -1, 0, 1, 0.5, 1e308, -1e308, 1e-308, float("nan"), float("inf"), 2**70, "", "x", "nan", "y" * 5000),
    *("../../outside/escaped", "/etc/hostname", "C:\\x\\y.png", "a\0b", "\ud800", "<b>", "images", "."),
    *(
        [],
        {},
        [[]],
        [1, 2, 3],
        [None],
        {"a": {}},
        [[float("nan")] * 4] * 4,
        np.zeros((4, 4)).tolist(),
        np.diag([1, 1, -1, 1]).tolist(),
    ),
)
WORDS = ("nan", "inf", "-1", "0", "1e999", "", "x", "-", "99999999999999999999", "1 2 3", "../../outside/escaped", "\x00", "ü")
SETTINGS = {
    "": ("up", "unit_m", "layout", "clean_plate"),
    "stokes": ("scale", "flip_s2", "rotate_deg"),
    "radiometry": (
        "black_level",
        "white_level",
        "encoding",
        "saturation",
        "dark_frame",
        "flat_field",
        "white_balance",
        "exposure_s",
    ),
    "mosaic": ("order", "colour", "bayer", "demosaic"),
    "stack": ("angles_deg", "clockwise", "zero_deg", "align"),
    "olat": ("lights", "irradiance", "near_light", "distortion", "specular_factor"),
    "poses": ("focal_px", "scale_pair", "scale_distance", "marker_length", "marker_dictionary"),
    "polarisers.A": ("angle_deg", "trusted", "extinction"),
    "stage.decode": ("precision", "x"),
    "nothing": ("x",),
}
Mutation = Callable[[Path, random.Random], None]


def files_of(root: Path) -> list[Path]:
    """The capture's files, sorted."""
    return sorted(p for p in root.rglob("*") if p.is_file())


def change_bytes(root: Path, rng: random.Random) -> None:
    """Cut a file, empty it, flip bits, overwrite a part, or add to its end."""
    path = rng.choice(files_of(root))
    content = bytearray(path.read_bytes())
    kind, at = rng.randrange(6), rng.randrange(max(1, len(content)))
    if kind == 0:
        content = content[:at]
    elif kind == 1:
        content = bytearray()
    elif kind == 2:
        for _ in range(rng.choice((1, 1, 1, 8, 100))):
            k = rng.randrange(min(len(content), rng.choice((64, 512, 1 << 20))) or 1)
            if content:
                content[k] ^= 1 << rng.randrange(8)
    elif kind == 3:
        content[at : at + 64] = rng.randbytes(64)
    elif kind == 4:
        content = bytearray(rng.randbytes(300))
    else:
        content += rng.randbytes(rng.choice((1, 40, 4000)))
    path.write_bytes(content)


def change_places(root: Path, rng: random.Random) -> None:
    """Remove a file, name it otherwise, exchange two, put a folder, a link or a pipe in its place, or a copy beside it."""
    path, other = rng.choice(files_of(root)), rng.choice(files_of(root))
    kind = rng.randrange(8)
    if kind == 0:
        path.unlink()
    elif kind == 1:
        name = rng.choice(("..", "x", "0", "ü ", "-n", "%s", "a" * 200, "999999999999", "$(x)", "<script>"))
        path.rename(path.with_name(name + path.suffix))
    elif kind == 2:
        content = path.read_bytes()
        path.write_bytes(other.read_bytes())
        other.write_bytes(content)
    elif kind == 3:
        path.unlink()
        path.mkdir()
    elif kind == 4:
        path.unlink()
        path.symlink_to(rng.choice((other, root, root / "nowhere", Path("/dev/zero"), path)))
    elif kind == 5:
        path.unlink()
        os.mkfifo(path)
    elif kind == 6:
        shutil.copyfile(path, path.with_name("copy_" + path.name))
    else:
        shutil.rmtree(path.parent) if path.parent != root else path.unlink()


def change_json(root: Path, rng: random.Random) -> None:
    """Put something odd at a random place of a JSON file, or take that away."""
    paths = [p for p in files_of(root) if p.suffix == ".json"]
    if not paths:
        return change_settings(root, rng)
    path = rng.choice(paths)
    document = json.loads(path.read_text())
    if rng.random() < 0.05:
        path.write_text(rng.choice(("[" * 100_000, '{"a":' * 100_000, json.dumps(rng.choice(ODD)), "{", "\ufeff{}")))
        return None
    for _ in range(rng.choice((1, 1, 2, 4))):
        node, key = _place(document, rng)
        if key is None:
            break
        if rng.random() < 0.2:
            del node[key]
        else:
            node[key] = rng.choice(ODD)
    path.write_text(json.dumps(document))
    return None


def _place(document: Any, rng: random.Random) -> tuple[Any, Any]:
    node, key = document, None
    while True:
        inside = node if key is None else node[key]
        keys = list(inside) if isinstance(inside, dict) else list(range(len(inside))) if isinstance(inside, list) else []
        if not keys or (key is not None and rng.random() < 0.35):
            return node, key
        node, key = inside, rng.choice(keys)


def change_text(root: Path, rng: random.Random) -> None:
    """Put an odd word in place of a number or name in a text file, or take a line away."""
    paths = [p for p in files_of(root) if p.suffix in (".txt", ".csv")]
    if not paths:
        return change_settings(root, rng)
    path = rng.choice(paths)
    words = re.split(r"([\s,]+)", path.read_text())
    for _ in range(rng.choice((1, 1, 3))):
        words[rng.randrange(len(words))] = rng.choice(WORDS)
    path.write_text("".join(words))
    return None


def change_settings(root: Path, rng: random.Random) -> None:
    """A capture.toml with odd values, of settings that are known and others."""
    lines = []
    for table in rng.sample(sorted(SETTINGS), rng.choice((1, 1, 2))):
        lines += [f"[{table}]"] if table else []
        lines += [f"{key} = {_toml(rng)}" for key in rng.sample(SETTINGS[table], 1)]
    text = "\n".join(sorted(lines, key=lambda line: line.startswith("[")) if lines and not lines[0].startswith("[") else lines)
    if rng.random() < 0.05:
        text = "x = " + "[" * 50_000
    path = root / "capture.toml"
    if path.is_file() or not path.exists():  # a pipe would wait for its reader
        path.write_text(text, errors="surrogatepass")


def _toml(rng: random.Random) -> str:
    odd = (
        "nan",
        "inf",
        "-inf",
        "0",
        "-1",
        "1e308",
        "true",
        '""',
        '"x"',
        "[]",
        "{}",
        "[1, 2]",
        "[nan, 0.0, 1.0]",
        '"../../outside/escaped"',
    )
    return rng.choice(
        (*odd, '"/dev/zero"', '"linear"', '"srgb"', '"y"', "99999999999999999999", "[0.0, 45.0, 90.0, 135.0]", "{ a = nan }")
    )


def change_arrays(root: Path, rng: random.Random) -> None:
    """Another shape, type or header of an array in a .npy or .npz, a missing one, one more."""
    paths = [p for p in files_of(root) if p.suffix in (".npy", ".npz")]
    if not paths:
        return change_images(root, rng)
    path = rng.choice(paths)
    if path.suffix == ".npy":
        if rng.random() < 0.2:
            _declare(path, rng)
        else:
            np.save(path, _odd_array(np.load(path), rng), allow_pickle=True)
        return None
    with path.open("rb") as file, np.load(file) as archive:  # by itself it leaves damaged files open
        arrays = {name: archive[name] for name in archive.files}
    name = rng.choice(sorted(arrays))
    kind = rng.randrange(4)
    if kind == 0:
        del arrays[name]
    elif kind == 1:
        arrays["one_more"] = np.zeros(3)
    else:
        arrays[name] = _odd_array(arrays[name], rng)
    np.savez(path, **arrays)
    return None


def _odd_array(a: np.ndarray, rng: random.Random) -> np.ndarray:
    changed: tuple[Callable[[], Any], ...] = (
        *(
            lambda: a[..., :-1] if a.ndim else a,
            lambda: a[None],
            lambda: a.ravel(),
            lambda: a * np.nan,
            lambda: a * 0,
            lambda: -a,
        ),
        *(
            lambda: a.astype(object),
            lambda: a.astype(str),
            lambda: a.astype("c16"),
            lambda: a.astype("f2"),
            lambda: a.astype("i1"),
        ),
        *(lambda: np.array("x"), lambda: np.zeros((0, 0, 3)), lambda: np.zeros(()), lambda: a * np.float64(1e300), lambda: a.T),
        lambda: np.zeros(3, [("a", "f4"), ("b", "i2")]),
    )
    with np.errstate(all="ignore"):
        return np.asarray(rng.choice(changed)())


def _declare(path: Path, rng: random.Random) -> None:
    """A header that tells of an absurd array."""
    shape = rng.choice(
        ("(100000, 100000, 3)", "(-1, 4, 3)", "(4, 4)", "('a',)", "()", "(1000000000000,)", "(24, 32, 3, 99999999)")
    )
    header = f"{{'descr': '<f4', 'fortran_order': False, 'shape': {shape}, }}".ljust(117) + "\n"
    path.write_bytes(b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header.encode() + b"\0" * 64)


def change_images(root: Path, rng: random.Random) -> None:
    """An image of another size, of other channels, or with samples that no camera gives."""
    paths = [p for p in files_of(root) if p.suffix in (".png", ".exr")]
    if not paths:
        return change_bytes(root, rng)
    path = rng.choice(paths)
    height, width = rng.choice(((24, 32), (32, 24), (1, 1), (2, 3), (25, 33), (48, 64)))
    value = rng.choice((0.0, 1.0, -1.0, float("nan"), float("inf"), 1e30, 0.3))
    if path.suffix == ".exr":
        names = rng.choice(
            (("R", "G", "B"), ("Y",), ("S0.R", "S0.G"), ("A",), tuple(f"S{k}.{c}" for k in range(3) for c in "RGB"))
        )
        write_exr(path, {name: np.full((height, width), value, np.float32) for name in names}, half=rng.random() < 0.5)
    else:
        level = int(255 * min(max(value, 0.0), 1.0)) if np.isfinite(value) else 7
        channels = rng.choice((1, 3, 4))
        write_png(path, np.full((height, width, channels), level, np.uint8))
    return None


MUTATIONS: tuple[Mutation, ...] = (
    change_bytes, change_bytes, change_places, change_json, change_json, change_text, change_settings, change_arrays,
    change_images,
)  # fmt: skip
