"""Hostile captures: a sound one of three tiny views, each damaged so that it reaches outside, executes, or swallows memory."""

from __future__ import annotations

import json
import os
import shutil
import socket
import struct
import zipfile
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

Damage = Callable[[Path], object]
Case = tuple[str, Damage]

OUTSIDE = "../outside/file"
NAMES = (
    *(
        "../outside/escaped",
        "../../outside/escaped",
        "..",
        ".",
        "",
        "/etc/hostname",
        "/etc/passwd",
        "/dev/zero",
        "/dev/stdin",
        "~/x",
    ),
    *(
        "$(touch outside/ran)",
        "`touch outside/ran`",
        "a;touch outside/ran",
        "$HOME/x",
        "%s%n%x",
        "a\nb",
        "a\0b",
        "-rf",
        "con",
        "C:\\x",
    ),
    *(
        "\ud800",
        "x" * 300,
        "x/" * 200 + "y",
        "a" * 100_000,
        "\u202egnp.exe",
        "file:///etc/passwd",
        "|touch outside/ran",
        "http://localhost/a",
    ),
    *(
        "\\\\server\\share",
        "images/../../outside/file",
        "{{7*7}}",
        "<script>alert(1)</script>",
        "{0.__class__}",
        "\x1b[2Jx",
        "\r\nx",
    ),
)
HUGE = 2**31 - 1


def capture_cases() -> Iterator[Case]:
    """Every damage of a capture by its name."""
    yield from _named()
    yield from _linked()
    yield from _special()
    yield from _declared()
    yield from _nested()
    yield from _pickled()
    yield from _swollen()


def _table(change: Callable[[dict[str, Any]], object]) -> Damage:
    def damage(root: Path) -> None:
        path = root / "transforms.json"
        table = json.loads(path.read_text())
        change(table)
        path.write_text(json.dumps(table))

    return damage


def _named() -> Iterator[Case]:
    for number, name in enumerate(NAMES):
        yield f"file_path {number} {name[:16]!r}", _table(lambda t, n=name: t["frames"][1].update(file_path=n))
        yield f"mask_path {number} {name[:16]!r}", _table(lambda t, n=name: t["frames"][1].update(mask_path=n))
    for number, name in enumerate(
        ("a\nb.exr", "$(touch outside ran).exr", "-rf.exr", "{{7*7}}.exr", "\x1b[2J.exr", "`id`.exr", "~.exr")
    ):

        def renamed(root: Path, name: str = name) -> None:
            (root / "images/001.exr").rename(root / "images" / name)
            _table(lambda t: t["frames"][1].update(file_path=f"images/{name}"))(root)

        yield f"file name {number} {name!r}", renamed


def _replaced(name: str, make: Callable[[Path], object]) -> Damage:
    def damage(root: Path) -> None:
        path = root / name
        if path.is_dir():
            shutil.rmtree(path)
        else:
            path.unlink(missing_ok=True)
        path.parent.mkdir(exist_ok=True)
        make(path)

    return damage


def _linked() -> Iterator[Case]:
    targets = {
        "outside": "../../outside/file",
        "zero": "/dev/zero",
        "itself": "001.exr",
        "nothing": "nowhere",
        "shadow": "/etc/shadow",
    }
    for label, target in targets.items():
        yield f"image is a link to {label}", _replaced("images/001.exr", lambda p, t=target: p.symlink_to(t))
        yield f"mask is a link to {label}", _replaced("masks/001.png", lambda p, t=target: p.symlink_to(t))
    for name in ("images", "masks"):
        yield f"{name} is a link outside", _replaced(name, lambda p: p.symlink_to("../outside"))
        yield f"{name} is a link to itself", _replaced(name, lambda p: p.symlink_to(p.name))
        yield f"{name} is a link to the root", _replaced(name, lambda p: p.symlink_to("/"))
        yield f"{name} is a link to its parent", _replaced(name, lambda p: p.symlink_to(".."))
        yield f"{name} holds a link to its parent", lambda r, n=name: (r / n / "loop").symlink_to("..")
    for name in ("transforms.json", "capture.toml"):
        yield f"{name} is a link outside", _replaced(name, lambda p: p.symlink_to("../outside/file"))
        yield f"{name} is a link to zero", _replaced(name, lambda p: p.symlink_to("/dev/zero"))
    yield "an image is a hard link outside", _replaced("images/001.exr", lambda p: os.link(p.parents[2] / "outside/file", p))
    yield "a stray link to the root", lambda r: (r / "all").symlink_to("/")


def _special() -> Iterator[Case]:
    def listening(path: Path) -> None:
        here = os.getcwd()
        os.chdir(path.parent)  # a socket's path may have a hundred characters
        try:
            with socket.socket(socket.AF_UNIX) as s:
                s.bind(path.name)
        finally:
            os.chdir(here)

    makers = {"a pipe": os.mkfifo, "a socket": listening, "a folder": lambda p: (p / "x").mkdir(parents=True)}
    for name in ("images/001.exr", "masks/001.png", "transforms.json", "capture.toml", "images/003.exr", "images", "sparse"):
        for label, make in makers.items():
            yield f"{name} is {label}", _replaced(name, make)


def _png(width: int, height: int, kind: bytes = b"\x08\x02") -> bytes:
    def chunk(name: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))

    header = struct.pack(">II", width, height) + kind + b"\0\0\0"
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(b"\0" * 1000)) + chunk(b"IEND", b"")


def _tiff(width: int, height: int) -> bytes:
    tags = [(256, 4, width), (257, 4, height), (258, 3, 16), (259, 3, 1), (262, 3, 1), (273, 4, 8), (277, 3, 1),
            (278, 4, height), (279, 4, 100)]  # fmt: skip
    body = b"".join(struct.pack("<HHII", t, k, 1, v) for t, k, v in tags)
    return b"II*\0" + struct.pack("<I", 8) + struct.pack("<H", len(tags)) + body + b"\0" * 104


def _npy(shape: tuple[int, ...], kind: str = "<f8") -> bytes:
    text = f"{{'descr': '{kind}', 'fortran_order': False, 'shape': {shape!r}, }}"
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(text) + 1) + text.encode() + b"\n"


def _exr_of_size(path: Path) -> bytes:
    """An EXR whose windows say a million pixels a side: the sound one's header with other numbers."""
    content = path.read_bytes()
    for name in (b"dataWindow\0box2i\0", b"displayWindow\0box2i\0"):
        at = content.index(name) + len(name) + 4
        content = content[:at] + struct.pack("<4i", 0, 0, 10**6, 10**6) + content[at + 16 :]
    return content


def _declared() -> Iterator[Case]:
    for width, height in ((HUGE, HUGE), (10**6, 10**6), (1, HUGE), (0, 0), (200_000, 200_000)):
        yield f"mask PNG of {width} x {height}", lambda r, w=width, h=height: (r / "masks/001.png").write_bytes(_png(w, h))
        for suffix, make in (("png", _png), ("tif", _tiff)):

            def image(root: Path, w: int = width, h: int = height, suffix: str = suffix, make: Any = make) -> None:
                (root / f"images/001.{suffix}").write_bytes(make(w, h))
                _table(lambda t: t["frames"][1].update(file_path=f"images/001.{suffix}"))(root)

            yield f"image {suffix} of {width} x {height}", image
    yield "EXR of a million pixels a side", lambda r: (r / "images/001.exr").write_bytes(_exr_of_size(r / "images/001.exr"))
    for key in ("w", "h", "fl_x", "cx"):
        for value in (10**9, -1, 1e308, "x" * 10**6, [[]] * 1000):
            yield f"{key} = {str(value)[:12]}", _table(lambda t, k=key, v=value: t.update({k: v}))
    for shape in ((10**6, 10**6), (2**62, 4), (0, 10**9), (-1, 4), (16, 16, 3, 3) * 8):

        def array(root: Path, shape: tuple[int, ...] = shape) -> None:
            (root / "images/001.npy").write_bytes(_npy(shape) + b"\0" * 4096)
            _table(lambda t: t["frames"][1].update(file_path="images/001.npy"))(root)

        yield f"image array of {shape[:3]}", array
    for count in (2**63 - 1, 2**40, 10**9):
        for name in ("cameras.bin", "images.bin", "points3D.bin"):

            def model(root: Path, name: str = name, count: int = count) -> None:
                (root / "sparse/0").mkdir(parents=True)
                for each in ("cameras.bin", "images.bin", "points3D.bin"):
                    (root / "sparse/0" / each).write_bytes(struct.pack("<Q", count if each == name else 0) + b"\1" * 200)
                (root / "transforms.json").unlink()

            yield f"{name} of {count} entries", model


def _nested() -> Iterator[Case]:
    deep = {
        "lists": "[" * 200_000,
        "closed lists": "[" * 100_000 + "]" * 100_000,
        "objects": '{"a":' * 100_000 + "1" + "}" * 100_000,
    }
    for label, text in deep.items():
        yield f"transforms.json of deep {label}", lambda r, t=text: (r / "transforms.json").write_text(t)
    numbers = {
        "a number of a million digits": "9" * 10**6,
        "a million decimals": "0." + "1" * 10**6,
        "a huge power": "1e999999999",
    }
    for label, text in numbers.items():
        whole = f'{{"fl_x": {text}, "frames": []}}'
        yield f"transforms.json of {label}", lambda r, t=whole: (r / "transforms.json").write_text(t)
    texts = {"deep arrays": "a = " + "[" * 50_000, "deep tables": "[" + ".".join("a" * 20_000) + "]\nx = 1",
             "a long text": f'up = "{"x" * 10**7}"', "a path": 'layout = "../outside/file"',
             "code": "up = \"$(touch outside/ran)\""}  # fmt: skip
    for label, text in texts.items():
        yield f"capture.toml of {label}", lambda r, t=text: (r / "capture.toml").write_text(t)
    entities = "".join(f'<!ENTITY a{k} "{f"&a{k - 1};" * 10}">' for k in range(1, 12))
    bomb = f'<?xml version="1.0"?><!DOCTYPE x [<!ENTITY a0 "lol">{entities}]><document><chunk>&a11;</chunk></document>'
    foreign = (
        '<?xml version="1.0"?><!DOCTYPE x [<!ENTITY f SYSTEM "file:///etc/passwd">]><document><chunk>&f;</chunk></document>'
    )
    for label, text in {"an entity bomb": bomb, "a foreign entity": foreign, "deep elements": "<a>" * 100_000}.items():

        def metashape(root: Path, text: str = text) -> None:
            (root / "transforms.json").unlink()
            (root / "cameras.xml").write_text(text)

        yield f"cameras.xml of {label}", metashape


class _Payload:
    def __reduce__(self) -> tuple[Any, tuple[str]]:
        return os.system, ("touch outside/ran",)


def _pickled() -> Iterator[Case]:
    import pickle

    payload = np.array([_Payload()], dtype=object)
    for suffix in ("npy", "npz"):

        def image(root: Path, suffix: str = suffix) -> None:
            path = root / f"images/001.{suffix}"
            np.save(path, payload, allow_pickle=True) if suffix == "npy" else np.savez(path, stokes=payload)
            _table(lambda t: t["frames"][1].update(file_path=f"images/001.{suffix}"))(root)

        yield f"image {suffix} with a pickle", image
        for name in ("poses_bounds", "cameras", "lights", "cameras_sphere"):

            def table(root: Path, suffix: str = suffix, name: str = name) -> None:
                (root / "transforms.json").unlink()
                path = root / f"{name}.{suffix}"
                np.save(path, payload, allow_pickle=True) if suffix == "npy" else np.savez(path, world_mat_0=payload)

            yield f"{name}.{suffix} with a pickle", table
    for name in ("params.pkl", "cameras.pkl", "model.pt", "images/001.pickle"):
        yield f"{name}", lambda r, n=name: (r / n).write_bytes(pickle.dumps(_Payload()))


def _sparse(path: Path) -> None:
    path.touch()
    os.truncate(path, 3 << 30)


def _swollen() -> Iterator[Case]:
    def stored(root: Path, shape: tuple[int, ...], claimed: bool) -> None:
        path = root / "images/001.npz"
        with (
            zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive,
            archive.open("stokes.npy", "w", force_zip64=True) as member,
        ):
            member.write(_npy(shape))
            for _ in range(64):
                member.write(b"\0" * (1 << 20))
        if claimed:  # a directory that says 16 EiB
            content = path.read_bytes()
            at = content.rindex(b"PK\1\2")
            path.write_bytes(content[: at + 20] + b"\xfe\xff\xff\xff\xfe\xff\xff\xff" + content[at + 28 :])
        _table(lambda t: t["frames"][1].update(file_path="images/001.npz"))(root)

    yield "npz of 64 MB of zeros", lambda r: stored(r, (2048, 4096), False)
    yield "npz of a terabyte declared", lambda r: stored(r, (2**17, 2**20), False)
    yield "npz whose directory lies", lambda r: stored(r, (2**17, 2**20), True)
    yield "an image of 3 GB of nothing", _replaced("images/001.exr", _sparse)
    yield "a mask of 3 GB of nothing", _replaced("masks/001.png", _sparse)
    yield "transforms.json of 3 GB of nothing", _replaced("transforms.json", _sparse)
    yield "capture.toml of 3 GB of nothing", _replaced("capture.toml", _sparse)
    yield "ten thousand empty files", lambda r: [(r / f"images/z{k}.exr").touch() for k in range(10_000)]
    yield "a hundred folders deep", lambda r: (r / "/".join(["deep"] * 100)).mkdir(parents=True)
