"""16-bit pictures under a display's curve are told by their codes or headers where these tell it, and asked about where not."""

from __future__ import annotations

import struct
import zlib

import numpy as np
import pytest

from pipeline.capture import open_capture
from pipeline.capture.radiometry.curve_in_codes import curve_in_codes
from pipeline.formats.images import srgb_encode
from pipeline.formats.png_curve import png_states_linear
from synth import ball

RNG = np.random.default_rng(0)
LIGHT = np.clip(RNG.lognormal(-2.0, 1.2, 300_000), 0, 1)
"""Linear light of a scene."""


def sensor(bits: int, gain: float = 1.0) -> np.ndarray:
    """Light as a sensor of so many bits has it, in 0..1."""
    return np.round(LIGHT * (2**bits - 1)) / (2**bits - 1) * gain


def test_gaps_of_a_sensors_codes_betray_a_displays_curve():
    found = curve_in_codes([ball.codes(srgb_encode(sensor(12)))])
    assert found is not None and "apart in the dark" in found


@pytest.mark.parametrize("gain", [1.0, 0.73])
@pytest.mark.parametrize("bits", [10, 12, 14])
def test_linear_codes_tell_nothing(bits, gain):
    assert curve_in_codes([ball.codes(sensor(bits, gain))]) is None


def test_renders_and_flat_colours_tell_nothing():
    assert curve_in_codes([ball.codes(srgb_encode(LIGHT))]) is None
    assert curve_in_codes([RNG.choice(RNG.integers(0, 65535, 200), 100_000).astype(np.uint16)]) is None
    assert curve_in_codes([np.zeros((8, 8), np.uint16)]) is None


def pictures(root, coded):
    for k, camera in enumerate(ball.ring(4)):
        ball.write(root / f"images/{k}.png", coded(ball.picture(camera)[0]))
    return open_capture(root)


def test_eight_bits_saved_as_sixteen_are_doubted(tmp_path):
    capture = pictures(tmp_path, lambda colour: ball.codes(srgb_encode(colour), 8).astype(np.uint16) * 257)
    (line,) = capture.warnings
    assert "hold 8 bits a sample" in line and 'radiometry.encoding = "srgb"' in line


def test_sixteen_bits_that_say_nothing_are_asked_about_on_the_page_alone(tmp_path):
    capture = pictures(tmp_path, ball.codes)
    assert not capture.warnings
    assert any("16-bit files are read as linear light" in fact and 'encoding = "srgb"' in fact for fact in capture.facts)
    (tmp_path / "capture.toml").write_text('radiometry.encoding = "linear"\n')
    assert not any("are read as linear light" in fact for fact in open_capture(tmp_path).facts)


def chunk(kind: bytes, body: bytes) -> bytes:
    return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))


CHUNKS = {
    "linear": (b"gAMA", struct.pack(">I", 100000)),
    "gamma": (b"gAMA", struct.pack(">I", 45455)),
    "cICP linear": (b"cICP", bytes([9, 8, 0, 1])),
    "cICP PQ": (b"cICP", bytes([9, 16, 0, 1])),
}


def states(path, name):
    """Put a chunk into a PNG, after its header."""
    data = path.read_bytes()
    path.write_bytes(data[:33] + chunk(*CHUNKS[name]) + data[33:])


@pytest.mark.parametrize("name", CHUNKS)
def test_a_png_that_states_linear_light_is_known(name, tmp_path):
    path = tmp_path / "a.png"
    ball.write(path, np.zeros((8, 8, 3), np.uint8))
    assert not png_states_linear(path)
    states(path, name)
    assert png_states_linear(path) is ("linear" in name)
    path.write_bytes(path.read_bytes()[:36])
    assert not png_states_linear(path)


@pytest.mark.parametrize(("bits", "name", "said"), [(8, "linear", True), (16, "linear", False), (8, "gamma", False)])
def test_a_png_that_states_another_curve_than_it_is_read_with_is_doubted(bits, name, said, tmp_path):
    pictures(tmp_path, lambda colour: ball.codes(colour, bits))
    for path in (tmp_path / "images").iterdir():
        states(path, name)
    told = "\n".join(open_capture(tmp_path).warnings)
    assert ("states linear light" in told) is said and (said or told == "")
