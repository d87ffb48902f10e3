"""Views that the capture's own tables hold out are held out; without such tables every eighth is."""

import json

import numpy as np
import pytest

from pipeline.formats.images import write_exr
from pipeline.geometry.cameras import save_cameras
from stages.train.views.source_views import load_sources, with_validation
from synth import ball

COUNT = 10


@pytest.fixture
def decoded(tmp_path):
    """A decode and a poses folder of small views; a function that writes which parts the capture tells."""
    cameras = {f"v{i}": camera for i, camera in enumerate(ball.ring(COUNT, 16))}
    for name, camera in cameras.items():
        colour = ball.picture(camera)[0]
        write_exr(tmp_path / f"frames/{name}.exr", {c: colour[..., k] for k, c in enumerate("RGB")})
    save_cameras(tmp_path / "cameras.json", cameras)
    facts = {"saturated": None, "camera": "camera", "width": 16, "height": 16}
    views = {name: {**facts, "file": f"frames/{name}.exr"} for name in cameras}

    def load(parts=None):
        told = {} if parts is None else {"parts": parts}
        (tmp_path / "frames.json").write_text(json.dumps({"polarisation": "none", "views": views, **told}))
        return load_sources(tmp_path, tmp_path, None, "auto")[0]

    return load


def names(sources, part):
    return [s.name for s in sources if s.split == part]


def test_every_eighth_view_is_held_out_where_nothing_is_told(decoded):
    assert names(decoded(), "test") == ["v0", "v8"]


def test_told_test_and_validation_views_are_held_out(decoded):
    parts = {f"v{i}": "test" if i in (3, 4) else "validation" if i == 7 else "train" for i in range(COUNT)}
    sources = decoded(parts)
    assert names(sources, "test") == ["v3", "v4"] and names(sources, "validation") == ["v7"]
    assert names(with_validation(sources, 3), "validation") == ["v7"]
    assert np.isfinite(sources[0].image).all()
