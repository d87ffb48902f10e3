"""A G-buffer file keeps its channels by name, whatever else stands beside them."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from pipeline.formats.gbuffer import CHANNELS, SurfaceImage, channels_of, read_gbuffer, surface_of, write_gbuffer
from pipeline.formats.images import channel_names, write_exr


def surface() -> SurfaceImage:
    rng = np.random.default_rng(0)
    return SurfaceImage(*(rng.random(shape).astype(np.float32) for shape in ((3, 4, 3), (3, 4, 5), (3, 4), (3, 4))))


def equal(a: SurfaceImage, b: SurfaceImage) -> bool:
    return all(np.array_equal(getattr(a, k), getattr(b, k)) for k in ("normal", "material", "alpha", "depth"))


def test_what_is_written_comes_back_and_channels_beside_it_stay_out(tmp_path: Path) -> None:
    channels = {"S0.R": np.ones((3, 4)), **channels_of(surface())}
    write_gbuffer(tmp_path / "a.exr", channels)
    assert set(channel_names(tmp_path / "a.exr")) == set(CHANNELS)
    assert equal(read_gbuffer(tmp_path / "a.exr"), surface())
    assert equal(surface_of(channels), surface())


def test_a_g_buffer_is_found_in_a_file_of_another_channel_order(tmp_path: Path) -> None:
    channels = dict(reversed(channels_of(surface()).items()))
    write_exr(tmp_path / "a.exr", {"diffuse.R": np.ones((3, 4)), **channels})
    assert equal(read_gbuffer(tmp_path / "a.exr"), surface())


def test_what_is_not_finite_is_written_as_nothing() -> None:
    broken = surface()
    broken.depth[0, 0] = np.nan
    assert channels_of(broken)["depth"][0, 0] == 0
