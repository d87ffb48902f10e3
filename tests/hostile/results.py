"""Hostile results: a finished dataset in which one file that later commands read was forged, its manifest with it."""

from __future__ import annotations

import io
import json
import re
import struct
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

Damage = Callable[[Path], object]
Case = tuple[str, Damage]
Change = Callable[[bytes], bytes]

EXRS = (
    "train/env.exr", "train/gbuffer/000.exr", "train/test/*.exr", "decode/frames/000.exr", "relight/*/000.exr",
    "mesh/asset/textures/*.exr",
)  # fmt: skip
PNGS = ("masks/000.png", "masks/006.png")
PLYS = ("train/gaussians.ply", "train/splats_lit.ply", "mesh/mesh.ply")
TABLES = (
    "decode/frames.json", "poses/cameras.json", "masks/masks.json", "train/lighting.json", "mesh/asset/asset.json",
    "metrics/metrics.json",
)  # fmt: skip
NAMES = ("../../../../outside/file", "/etc/passwd", "a\0b", "x" * 5000, "\x1b[2J", "$(touch outside/ran)")
MILLION = 10**6


def result_cases() -> Iterator[Case]:
    """Every forgery by its name."""
    for place in EXRS:
        for label, change in _exrs():
            yield f"{place} {label}", _forged(place, change)
    for place in PNGS:
        for label, change in _pngs():
            yield f"{place} {label}", _forged(place, change)
    for place in PLYS:
        for label, change in (*_ply_headers(), *_ply_bodies()):
            yield f"{place} {label}", _forged(place, change)
    for label, change in _faces():
        yield f"mesh/mesh.ply {label}", _forged("mesh/mesh.ply", change)
    for place in TABLES:
        for label, change in _tables():
            yield f"{place} {label}", _forged(place, change)
    for label, change in (("of binary", lambda _: bytes(range(256)) * 40), ("of one line", lambda _: b"1" * 10**7)):
        yield f"train/train_log.csv {label}", _forged("train/train_log.csv", change)
        yield f"mesh/asset/*.glb {label}", _forged("mesh/asset/*.glb", change)
        yield f"poses/sparse/images.txt {label}", _forged("poses/sparse/images.txt", change)


def rig_cases() -> Iterator[Case]:
    """The same of a light stage's results."""
    for place in ("olat/cam00/normal.exr", "olat/cam00/sigma.exr", "olat/cam00/residual.exr", "relight/*/cam00_olat.exr"):
        for label, change in _exrs():
            yield f"{place} {label}", _forged(place, change)
    for place in ("decode/olat.json", "olat/maps.json", "masks/masks.json"):
        for label, change in _tables():
            yield f"{place} {label}", _forged(place, change)
    for label, change in _pngs():
        yield f"masks/cam00.png {label}", _forged("masks/cam00.png", change)
    for label, change in _archives():
        yield f"olat/cam00/samples.npz {label}", _forged("olat/cam00/samples.npz", change)


def _forged(place: str, change: Change) -> Damage:
    """Change a file, and the manifest that tells its size and digest, sealed again: what a stranger can do."""

    def damage(root: Path) -> None:
        from pipeline.engine.dataset import Dataset
        from pipeline.engine.dataset.digests import digest_file
        from pipeline.engine.dataset.documents import sealed

        stage, _, pattern = place.partition("/")
        version = Dataset(root).current(stage)
        assert version is not None
        path = sorted(version.folder.glob(pattern))[0]
        path.write_bytes(change(path.read_bytes()))
        manifest = json.loads((version.folder / "manifest.json").read_text())
        for output in manifest["outputs"]:
            if output["path"] == path.relative_to(version.folder).as_posix():
                output.update(bytes=path.stat().st_size, digest=digest_file(path))
        (version.folder / "manifest.json").write_text(sealed(manifest))

    return damage


def _window(content: bytes, width: int, height: int) -> bytes:
    """An EXR whose windows say another size."""
    for name in (b"dataWindow\0box2i\0", b"displayWindow\0box2i\0"):
        at = content.index(name) + len(name) + 4
        content = content[:at] + struct.pack("<4i", 0, 0, width - 1, height - 1) + content[at + 16 :]
    return content


def _written(channels: dict[str, np.ndarray]) -> bytes:
    import tempfile

    from pipeline.formats.images import write_exr

    with tempfile.TemporaryDirectory() as folder:
        write_exr(Path(folder) / "x.exr", channels)
        return (Path(folder) / "x.exr").read_bytes()


def _same_channels(content: bytes, size: tuple[int, int], value: float) -> bytes:
    """An EXR of the same channels, of another size, and of one value."""
    import tempfile

    from pipeline.formats.images import channel_names

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "x.exr"
        path.write_bytes(content)
        names = channel_names(path)
    return _written({name: np.full(size, value, np.float32) for name in names})


def _exrs() -> Iterator[tuple[str, Change]]:
    yield "of a thousand million pixels", lambda b: _window(b, 31623, 31623)
    yield "of a million pixels a side", lambda b: _window(b, MILLION, MILLION)
    yield "of one long row", lambda b: _window(b, 2**31 - 1, 1)
    yield "of other channels", lambda b: _written({"Q": np.ones((16, 32), np.float32)})
    yield "of no channel in common but R", lambda b: _written({"R": np.ones((16, 32), np.float32)})
    for label, value in {"not a number": np.nan, "infinite": np.inf, "huge": 3e38, "negative": -3e38, "zero": 0.0}.items():
        yield f"of pixels that are {label}", lambda b, v=value: _same_channels(b, (16, 32), v)
    yield "of one pixel", lambda b: _same_channels(b, (1, 1), 1.0)
    yield "of one row", lambda b: _same_channels(b, (1, 500), 1.0)
    yield "cut off", lambda b: b[: len(b) // 2]
    yield "of noise", lambda b: b[:300] + np.random.default_rng(0).bytes(len(b))
    yield "that is empty", lambda b: b""


def _pngs() -> Iterator[tuple[str, Change]]:
    from captures import _png

    yield "of a million pixels a side", lambda b: _png(MILLION, MILLION)
    yield "of 30 000 pixels a side", lambda b: _png(30_000, 30_000)
    yield "of one pixel", lambda b: _png(1, 1)
    yield "that is empty", lambda b: b""
    yield "cut off", lambda b: b[: len(b) // 2]


def _header(content: bytes, pattern: bytes, put: bytes) -> bytes:
    return re.sub(pattern, put, content, count=1)


def _ply_headers() -> Iterator[tuple[str, Change]]:
    for count in (b"9223372036854775807", b"1000000000", b"-1", b"1e9", b"9" * 5000):
        yield (
            f"of {count[:20].decode()} vertices",
            lambda b, n=count: _header(b, rb"element vertex \d+", b"element vertex " + n),
        )
    yield "of lists", lambda b: _header(b, rb"property float x", b"property list uint float x")
    yield "of long lists", lambda b: _header(b, rb"property float x", b"property list uint double x\nproperty float x0")
    many = b"".join(b"property float p%d\n" % k for k in range(100_000))
    yield "of many properties", lambda b: _header(b, rb"end_header", many + b"end_header")
    yield "of two of one name", lambda b: _header(b, rb"property float y", b"property float x")
    yield "of no property", lambda b: re.sub(rb"property float [^\n]*\n", b"", b)
    yield "of words", lambda b: _header(b, rb"format binary_little_endian", b"format ascii")
    yield "of another format", lambda b: _header(b, rb"format binary_little_endian 1.0", b"format zip 9")
    nothing = b"element nothing 9223372036854775807\n"
    yield "of rows without anything", lambda b: _header(b, rb"element vertex", nothing + b"element vertex")
    yield "without an end", lambda b: _header(b, rb"end_header", b"")


def _ply_bodies() -> Iterator[tuple[str, Change]]:
    def filled(content: bytes, word: bytes) -> bytes:
        at = content.index(b"end_header\n") + 11
        return content[:at] + (word * (len(content) // 4 + 1))[: len(content) - at]

    for label, number in {"not a number": np.nan, "infinite": np.inf, "huge": 3e38, "zero": 0.0}.items():
        yield f"of numbers that are {label}", lambda b, n=number: filled(b, struct.pack("<f", n))
    yield "cut off", lambda b: b[: len(b) * 2 // 3]
    yield "that is empty", lambda b: b""
    head = b"ply\nformat ascii 1.0\nelement vertex 0\nproperty float x\nproperty float y\nproperty float z\nend_header\n"
    yield "of nothing", lambda b: head


def _faces() -> Iterator[tuple[str, Change]]:
    def faced(content: bytes, corners: tuple[int, int, int], length: int = 3) -> bytes:
        return content[:-13] + struct.pack("<B3i", length, *corners)

    for corners in ((0, 1, 2**31 - 1), (0, 1, -1), (0, 0, 0)):
        yield f"of a face {corners}", lambda b, c=corners: faced(b, c)
    yield "of a face of 255 corners", lambda b: faced(b, (0, 1, 2), 255)
    yield "without faces", lambda b: _header(b, rb"element face \d+", b"element face 0")


def _archives() -> Iterator[tuple[str, Change]]:
    from captures import _npy, _Payload

    def archive(arrays: dict[str, Any], raw: bytes | None = None) -> bytes:
        content = io.BytesIO()
        if raw is None:
            np.savez(content, **arrays)
        else:
            with zipfile.ZipFile(content, "w", zipfile.ZIP_DEFLATED) as made:
                for name in arrays:
                    made.writestr(f"{name}.npy", raw)
        return content.getvalue()

    def with_arrays(content: bytes, change: Callable[[dict[str, np.ndarray]], object]) -> bytes:
        arrays = dict(np.load(io.BytesIO(content)))
        change(arrays)
        return archive(arrays)

    names = ("pixels", "lights", "cross", "parallel")
    yield "of pickles", lambda b: archive({n: np.array([_Payload()], dtype=object) for n in names})
    yield "of a pickle among arrays", lambda b: with_arrays(b, lambda a: a.update(pixels=np.array([_Payload()], dtype=object)))
    for shape in ((10**6, 10**6), (2**62, 4), (-1, 3)):
        yield f"of arrays of {shape}", lambda b, s=shape: archive(dict.fromkeys(names), _npy(s) + b"\0" * 4096)
    yield "of a gigabyte of zeros", lambda b: archive({"pixels": 0}, _npy((1 << 27,)) + bytes(1 << 30))
    for place in (-1, 10**9):
        yield f"of pixel {place}", lambda b, p=place: with_arrays(b, lambda a: a.update(pixels=np.full_like(a["pixels"], p)))
        yield f"of light {place}", lambda b, p=place: with_arrays(b, lambda a: a.update(lights=np.full_like(a["lights"], p)))
    yield "of other lengths", lambda b: with_arrays(b, lambda a: a.update(cross=a["cross"][:1]))
    yield "of other axes", lambda b: with_arrays(b, lambda a: a.update(sigma=a["sigma"][0]))
    yield "of numbers that are none", lambda b: with_arrays(b, lambda a: a.update(cross=np.full_like(a["cross"], np.nan)))
    yield "that is empty", lambda b: b""
    yield "cut off", lambda b: b[: len(b) // 2]


def _tables() -> Iterator[tuple[str, Change]]:
    for text in (b"", b"{}", b"[]", b"null", b"3", b'"x"', b"[" * 200_000, b"{" * 10, b"9" * 10**6):
        yield f"of {text[:8].decode()!r}", lambda b, t=text: t
    for number in range(6):  # of the keys, in order: gone, or of another type
        yield f"without key {number}", lambda b, n=number: _changed(b, n, None)
        for value in ("x", 7, [1], {}, 1e308):
            yield f"with {value!r} for key {number}", lambda b, n=number, v=value: _changed(b, n, v)
    for name in NAMES:
        yield f"with inner names {name[:12]!r}", lambda b, n=name: _renamed(b, n)
    for value in ("x", [], {}, -1, 1e308, 0):
        yield f"of numbers that are {value!r}", lambda b, v=value: json.dumps(_numbers(json.loads(b), v)).encode()


def _changed(content: bytes, number: int, value: Any) -> bytes:
    table = json.loads(content)
    keys = list(table)
    if number < len(keys):
        if value is None:
            del table[keys[number]]
        else:
            table[keys[number]] = value
    return json.dumps(table).encode()


def _renamed(content: bytes, name: str) -> bytes:
    """The first name of every inner table, and every path, is another."""

    def swap(value: Any, deep: int) -> Any:
        if isinstance(value, dict):
            items = [(k, swap(v, deep + 1)) for k, v in value.items()]
            return dict([(name, items[0][1]), *items[1:]]) if deep == 1 and items else dict(items)
        if isinstance(value, list):
            return [swap(v, deep + 1) for v in value]
        return name if isinstance(value, str) and ("/" in value or "." in value or value == "000") else value

    return json.dumps(swap(json.loads(content), 0)).encode()


def _numbers(value: Any, put: Any) -> Any:
    if isinstance(value, dict):
        return {k: _numbers(v, put) for k, v in value.items()}
    if isinstance(value, list):
        return [_numbers(v, put) for v in value]
    return put if isinstance(value, int | float) and not isinstance(value, bool) else value
