"""The viewer's scripts, shaders and scene as text for the page."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

FOLDER = Path(__file__).parent
SCRIPTS = (
    "bytes", "vectors", "octahedral", "prefilter", "hdr", "programs", "orbit", "gestures", "pace", "probe", "splats", "model",
    "readout", "model_viewer", "model_input", "rig", "fit_charts", "rig_viewer", "enlarge", "main",
)  # fmt: skip
"""In the order in which they need each other."""
SHADERS = ("*.glsl", "*.vert", "*.frag")


def script() -> str:
    """All of the viewer's JavaScript, its shaders as strings."""
    shaders = {p.name: p.read_text(encoding="utf-8") for pattern in SHADERS for p in sorted(FOLDER.glob(pattern))}
    parts = [(FOLDER / f"{name}.js").read_text(encoding="utf-8") for name in SCRIPTS]
    return "'use strict';\n{\nconst SHADERS = " + embedded(shaders) + ";\n" + "\n".join(parts) + "}\n"


def embedded(value: Any) -> str:
    """JSON that may stand in a page's <script>: no text in it can end the script."""
    return json.dumps(value, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c")


def style() -> str:
    """The viewer's style sheet."""
    return (FOLDER / "viewer.css").read_text(encoding="utf-8")
